"""The report page of a run in the loop."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np

from hils.run_page import run_page

# Values are rounded to 1e-4 of their range, or finer.
ROUNDING = 1e-4
HOSTILE = "</script><script>alert(1)</script>"


def run(online: bool = True) -> Any:
    """Wheel that sinks by 3 mm in 6 s, 0.1 mm less deep in the simulation, driven at slip 0.2."""
    time = np.linspace(-1.0, 6.0, 701)
    ticks = np.linspace(0.0, 5.0, 501)
    return SimpleNamespace(
        title=f"a run of {HOSTILE}",
        measured=SimpleNamespace(time=time, z=-0.014 - 5e-4 * time),
        online=SimpleNamespace(time=ticks, z_sim=-0.0139 - 5e-4 * ticks, zeta=0.7 + 0.01 * ticks)
        if online
        else None,
        command=SimpleNamespace(
            time=np.array([0.0, 5.0]), omega=np.array([0.5, 0.5]), vx=np.array([0.04, 0.04])
        ),
        setup=SimpleNamespace(wheel_radius=0.1),
    )


def test_the_page_has_the_outcome_and_the_curves_while_the_loop_ticked():
    text = run_page(run(), f"{HOSTILE}.h5", ["Completed.", "zeta 0.7 to 0.75"])
    assert text is not None
    assert HOSTILE not in text
    assert '<p class="verdict">Completed.</p>' in text
    curves = json.loads(text.split('id="curves">')[1].split("</script>")[0])
    (shown,) = curves["runs"]
    assert (shown["time"][0], shown["time"][-1]) == (0.0, 5.0)
    sinkage, zeta, slip = shown["panels"]
    time = np.array(shown["time"])
    np.testing.assert_allclose(sinkage["recorded"], 14 + 0.5 * time, rtol=0, atol=ROUNDING * 2.5)
    np.testing.assert_allclose(sinkage["after"], -0.1, rtol=0, atol=ROUNDING * 2.5)
    assert zeta["recorded"] is None
    np.testing.assert_allclose(zeta["after"], 0.7 + 0.01 * time, rtol=0, atol=ROUNDING * 0.05)
    np.testing.assert_allclose(slip["after"], 0.2, rtol=0, atol=1e-3)


def test_a_run_with_its_carriage_free_has_no_page():
    assert run_page(run(online=False), "run.h5", ["Completed."]) is None
