"""A run log with everything in it, and records as plain values that can be compared."""

import dataclasses

import numpy as np

from drftjax.runlog.record import Events, Measured, Online, RecordedCommand, RecordedSetup, RunLog


def example_run(rows: int = 60) -> RunLog:
    """Run log with every group and channel; no channel is 0 everywhere."""
    time = 0.01 * np.arange(rows)
    ticks = 0.004 + 0.02 * np.arange(rows // 2)
    wave = np.sin(ticks)
    return RunLog(
        setup=RecordedSetup(
            wheel_radius=0.15,
            wheel_width=0.12,
            grouser_count=12,
            grouser_height=0.018,
            grouser_thickness=0.009,
            mass_x=13.902,
            mass_z=18.837,
            gravity=9.81,
            bulk_density=1490.0,
            sinkage_static=0.0176,
            scaling_factor_initial=0.7823,
        ),
        command=RecordedCommand(time, 0.5 * np.sin(time), 0.01 + 0.0 * time),
        measured=Measured(
            time + 0.003, time * 0.07, -0.02 - 0.01 * time, time + 1, time + 180, time - 2
        ),
        source="virtual rig",
        title="Prüfstand № 7: 砂 🛞",
        online=Online(
            time=ticks,
            zeta=0.78 + 0.01 * wave,
            x_sim=0.07 * ticks,
            z_sim=-0.02 + 0.001 * wave,
            vx_sim=0.07 + wave,
            fx_sim=3 * wave,
            fz_sim=184.8 + wave,
            tuned=np.arange(ticks.size) % 2,
            late=np.abs(wave) * 1e-4,
            age=0.01 + 0 * wave,
            flags=2**31 + np.arange(ticks.size),
            seq_sent=np.arange(ticks.size) + 2**32 - ticks.size,
            seq_received=np.arange(ticks.size),
            rig_time=ticks + 100,
            tick=0.02,
            zeta_step=0.001,
            tolerance=1e-4,
            loop='{"tuner": "step", "ζ": 0.1}',
            meanings={1: "fresh", 2**31: "not_finite"},
        ),
        events=Events([0.1, 0.1, 0.2], [1, 2, 1], [0.0, -3.5, 7.0], {1: "tick late", 2: "fault"}),
        created="2024-05-06T07:08:09+02:00",
        run_id="r-1",
        notes="two\nlines",
        software="drftjax",
        software_version="0.1",
        end_reason="completed",
    )


def flattened(record: object) -> dict[str, object]:
    """Numbers and texts of a record by their place, arrays as bytes with their type."""
    found: dict[str, object] = {}
    for field in dataclasses.fields(record):  # pyright: ignore[reportArgumentType]
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            found |= {f"{field.name}.{key}": each for key, each in flattened(value).items()}
        elif isinstance(value, np.ndarray):
            found[field.name] = (value.dtype.str, value.tobytes())
        else:
            found[field.name] = value
    return found
