"""Dynamic resistive force theory for rover wheels on sand, on JAX.

    import drftjax

    result = drftjax.fit("data/runs/fast.h5")
    found = drftjax.diagnose("data/blind/demo")

The public names below are imported on first use, so that `import drftjax` and `drft --help` stay
fast and a program can still set JAX up before it is loaded. Type checkers read `__init__.pyi`.
"""

from drftjax.common.lazy import lazy_attributes, uncover

__version__ = "0.1.0"

uncover("identify")

_HOMES = {
    "ChangeDiagnosis": "diagnose.change.result",
    "Command": "drftjax.physics.command",
    "ConstantZeta": "drftjax.physics.terrain",
    "Diagnosis": "diagnose.result",
    "DrivenCarriage": "drftjax.physics.rig",
    "Dynamic": "drftjax.physics.stress",
    "Evaluation": "diagnose.evaluation.result",
    "FitResult": "identify.results.result",
    "FreeCarriage": "drftjax.physics.rig",
    "GrouserWheel": "drftjax.physics.wheel",
    "InputError": "drftjax.common.errors",
    "KnotZeta": "drftjax.physics.terrain",
    "OutlineWheel": "drftjax.physics.outline_wheel",
    "Output": "drftjax.physics.state",
    "Parameter": "identify.parameters.parameter",
    "PerStepZeta": "drftjax.physics.terrain",
    "PlainWheel": "drftjax.physics.wheel",
    "Plates": "drftjax.physics.wheel",
    "PosteriorSettings": "identify.uncertainty.markov_chains",
    "QuasiStatic": "drftjax.physics.stress",
    "Rig": "drftjax.physics.rig",
    "RunLog": "drftjax.runlog.record",
    "Simulator": "drftjax.simulation.simulator",
    "State": "drftjax.physics.state",
    "StressCoefficients": "drftjax.physics.stress",
    "Terrain": "drftjax.physics.terrain",
    "configure_jax": "drftjax.common.jax_config",
    "diagnose": "diagnose.api",
    "evaluate": "diagnose.api",
    "fit": "identify.api",
    "own": "identify.parameters.parameter",
    "read_run": "drftjax.runlog.hdf5.api",
    "shared": "identify.parameters.parameter",
    "simulate": "drftjax.simulation.rollout",
    "write_run": "drftjax.runlog.hdf5.api",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

__getattr__, __dir__ = lazy_attributes(globals(), _HOMES)
