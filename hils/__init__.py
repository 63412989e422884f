"""The online loop: DRFT steps beside a real single-wheel rig, and tunes zeta by its sinkage."""
