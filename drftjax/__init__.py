"""Dynamic resistive force theory for rover wheels on sand, on JAX.

    import drftjax as dj

    run = dj.simulate("data/paper.toml", zeta=0.7)
    result = dj.fit("data/runs/fast.h5")
    found = dj.diagnose("data/blind/demo")

The public names below are imported on first use, so that `import drftjax` and `drft --help` stay
fast and a program can still set JAX up before it is loaded. Type checkers read `__init__.pyi`.
"""

from drftjax.common.lazy import lazy_attributes, uncover

__version__ = "0.1.0"

uncover("identify")

_HOMES = {
    "ChangeDiagnosis": "diagnose.change.result",
    "Command": "drftjax.physics.command",
    "CommandSetUp": "drftjax.setups.setup",
    "ConstantZeta": "drftjax.physics.terrain",
    "Diagnosis": "diagnose.result",
    "DrivenCarriage": "drftjax.physics.rig",
    "Dynamic": "drftjax.physics.stress",
    "DynamicTerrain": "drftjax.setups.terrain_setup",
    "Evaluation": "diagnose.evaluation.result",
    "FitResult": "identify.results.result",
    "FreeCarriage": "drftjax.physics.rig",
    "GrouserWheel": "drftjax.physics.wheel",
    "InputError": "drftjax.common.errors",
    "IntegratorSetUp": "drftjax.setups.setup",
    "KnotZeta": "drftjax.physics.terrain",
    "OutlineWheel": "drftjax.physics.outline_wheel",
    "Output": "drftjax.physics.state",
    "Parameter": "identify.parameters.parameter",
    "ParameterSweep": "drftjax.sweeps.parameter_sweep",
    "PerStepZeta": "drftjax.physics.terrain",
    "PlainWheel": "drftjax.physics.wheel",
    "Plates": "drftjax.physics.wheel",
    "PosteriorSettings": "identify.uncertainty.markov_chains",
    "QuasiStatic": "drftjax.physics.stress",
    "QuasiStaticTerrain": "drftjax.setups.terrain_setup",
    "Rig": "drftjax.physics.rig",
    "RigSetUp": "drftjax.setups.setup",
    "RunLog": "drftjax.runlog.record",
    "SetUp": "drftjax.setups.setup",
    "Simulator": "drftjax.simulation.simulator",
    "StartSetUp": "drftjax.setups.setup",
    "State": "drftjax.physics.state",
    "SteadySettings": "drftjax.sweeps.steady_state",
    "SteadyState": "drftjax.sweeps.steady_state",
    "StressCoefficients": "drftjax.physics.stress",
    "Terrain": "drftjax.physics.terrain",
    "WheelSetUp": "drftjax.setups.setup",
    "configure_jax": "drftjax.common.jax_config",
    "diagnose": "diagnose.api",
    "evaluate": "diagnose.api",
    "fit": "identify.api",
    "own": "identify.parameters.parameter",
    "read_run": "drftjax.runlog.hdf5.api",
    "read_setup": "drftjax.setups.setup",
    "shared": "identify.parameters.parameter",
    "simulate": "drftjax.setups.api",
    "slip_curve": "drftjax.sweeps.steady_state",
    "steady_state": "drftjax.sweeps.steady_state",
    "sweep": "drftjax.sweeps.parameter_sweep",
    "trajectory": "drftjax.setups.api",
    "write_run": "drftjax.runlog.hdf5.api",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

__getattr__, __dir__ = lazy_attributes(globals(), _HOMES)
