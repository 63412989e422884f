"""Hardware in the loop: the simulation steps beside a real single-wheel rig and tunes zeta."""
