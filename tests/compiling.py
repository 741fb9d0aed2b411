"""Fills numba's cache in the order in which the tests ask for it: `python compiling.py`, beside a run of the tests.

Each step does something small with the very types of arrays that production has. What fails here fails in the tests
too, with more to say; what is forgotten here is compiled by the test that needs it.
"""

import contextlib
import os
import signal
import sys
import threading
import time

import numpy as np

UNASKED_S = 900.0  # no run that is waited for takes so long


def curves():
    from compared_curves import take

    from lipmetrics.compare import align, pairs

    align(take(), take(late_s=0.1))
    align(take(), take(late_s=0.1), cost="squared")
    pairs([take(name="a")], [take(name="b")])


def truths():
    from moved_mouth import moved_mouth

    from lipmetrics.openings import measure_outline
    from lipmetrics.outline import fill_outlines
    from simulator.camera import Camera
    from simulator.truth import truth

    outline = np.array([(2.0, 2.0), (2.0, 6.0), (5.0, 4.0)])
    measure_outline(outline)
    fill_outlines([outline], (8, 8))
    mouth, motion = moved_mouth("low", times=3)
    truth(motion, mouth, Camera())


def mouths():
    from drawn_mouth import opened, plain

    from lipmetrics.still import look_at

    for method in ("thesis", "default"):
        look_at(plain(opened(0.3)).picture, method=method)


def videos():
    from lipmetrics.demo import rehearse

    rehearse("default")
    rehearse("thesis")


def motions():
    """Of hexahedra first, as most tests are about them."""
    for element_type, precision in (
        ("H8", "mixed"),
        ("H8", "float64"),
        ("H8", "float32"),
        ("T4", "mixed"),
        ("T4ANP", "mixed"),
        ("T4", "float64"),
        ("T4ANP", "float64"),
    ):
        move(element_type, precision)


def move(element_type, precision):
    from meshes import Ramp, distorted

    from simulator.model import Fixed, Gravity
    from simulator.solver import solve

    loads = (Fixed(np.arange(4)), Gravity(9.81, (0, 0, 1), Ramp(0.1)))
    model = distorted(element_type, np.random.default_rng(0), loads=loads, duration_s=1e-3)
    solve(model, precision=precision, threads=1)


def pictures():
    from moved_mouth import moved_mouth

    from simulator.camera import Camera
    from simulator.render import render

    mouth, motion = moved_mouth("low", times=2)
    for _ in render(motion, mouth, Camera(width_px=64, height_px=48), times_s=[0.0, 1.0], frame_rate=10):
        pass


def forces():
    from meshes import ELEMENT_TYPES, distorted
    from test_simulator_elements import compiled_forces

    for element_type, precision in (*((kind, "float64") for kind in ELEMENT_TYPES), ("H8", "mixed")):
        model = distorted(element_type, np.random.default_rng(0))
        compiled_forces(model, np.zeros_like(model.nodes), precision)


def end_with(parent: int) -> None:
    """A run of tests that is killed takes this process along."""
    started = time.monotonic()
    while os.getppid() == parent and time.monotonic() - started < UNASKED_S:
        time.sleep(1.0)
    os._exit(1)


def main(parent: int) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that temporary folders go
    threading.Thread(target=end_with, args=(parent,), daemon=True).start()
    for step in (truths, curves, mouths, videos, motions, pictures, forces):
        with contextlib.suppress(Exception):
            step()


if __name__ == "__main__":
    main(int(sys.argv[1]))
