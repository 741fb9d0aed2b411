"""The solver on a graphics card: numba's simulated one everywhere, a real one where there is one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import simulated_card
from glued_blocks import glued_blocks

from simulator import assembly, cli, cuda
from simulator.curves import KeyFrames
from simulator.errors import InputError
from simulator.mesh import lip_sheet
from simulator.model import Fixed, Model
from simulator.partition import in_batches, partition
from simulator.solver import solve

HERE = Path(__file__).parent
OPENING = KeyFrames((0.0, 0.03, 0.06, 0.25), (0.0, 1.0, -0.1, -0.1), ("linear",) * 3)


def real_card() -> bool:
    return cuda.cuda is not None and cuda.cuda.is_available()


on_a_real_card = pytest.mark.skipif(not real_card(), reason="no NVIDIA card that numba can use")


@pytest.fixture(scope="module")
def simulated() -> dict[str, dict]:
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-W", "ignore", str(HERE / "simulated_card.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("case", simulated_card.CASES)
def test_the_card_moves_as_the_processor_does(simulated, case):
    found = simulated[case]
    assert found["device"] == "cuda"
    assert found["steps"][0] == found["steps"][1] > 3
    assert found["stopped"][0] == found["stopped"][1]
    limit = 1e-6 if case.endswith("mixed") else 1e-11
    assert found["motion_m"] <= limit * found["moved_m"]
    assert found["energies"] <= 10 * limit * found["work"]  # sums of small differences


@pytest.mark.slow
def test_the_card_breaks_and_heals_saliva_and_goes_back_as_the_processor_does(simulated):
    saliva = simulated["saliva"]
    assert saliva["states"] == [0, 1, 2] and saliva["same_states"]
    assert saliva["stretch"] < 1e-12
    assert simulated["a step halved"]["restarts"] > 0
    assert "too large" in simulated["a step far too large"]["stopped"][0]


@pytest.mark.parametrize("blocks", [1, 2, 7, 132])
def test_blocks_share_a_mesh_out(blocks):
    model = glued_blocks(OPENING, columns=40)
    count, laws = len(model.nodes), assembly.laws(model)
    parts = partition(model.elements, laws, count)
    batches = in_batches(parts, laws, 16, cuda.workers(blocks))
    elements = assembly.element_arrays(model, batches, np.float32, 1e-5, 16)
    mass = assembly.masses(model)
    nodes = assembly.node_arrays(model, parts, "mixed", 1e-5, mass)
    loads, _, _ = assembly.load_arrays(model, parts, mass)
    film, _ = assembly.film_arrays(model, parts)
    plan, pairs, chains = cuda._plan(elements, nodes, loads, film, count, blocks, False)

    assert np.array_equal(np.sort(plan.order), np.arange(count))
    assert len(plan.node_starts) == len(plan.chain_starts) == blocks + 1
    assert plan.node_starts[-1] == count and plan.chain_starts[-1] == len(chains["pair_starts"]) - 1
    assert blocks == 1 or plan.node_starts[-2] == count  # the last block only keeps the books
    block_of = np.empty(count, int)
    block_of[plan.order] = np.repeat(np.arange(blocks), np.diff(plan.node_starts))
    chain_block = np.repeat(np.arange(blocks), np.diff(plan.chain_starts))
    pair_block = np.repeat(chain_block, np.diff(chains["pair_starts"]))
    for ends in (chains["pair_lower"], chains["pair_upper"]):
        assert np.array_equal(block_of[ends.astype(int)], pair_block)
    assert np.array_equal(np.sort(pairs), np.arange(len(film.pair_lower)))

    # Each force on a corner or an end of a strut comes to its node, once.
    force = np.random.default_rng(0).normal(size=plan.forces.shape[1])
    force[-1] = 0
    at = np.concatenate([elements.numbers // 4, np.stack([film.lower, film.upper], axis=2).astype(int).ravel()])
    real = at < count
    expected = np.bincount(at[real], force[: len(at)][real], minlength=count)
    gathered = np.zeros(count)
    gathered[plan.order] = np.where(np.arange(len(plan.places))[:, None] < plan.used, force[plan.places], 0).sum(axis=0)
    assert np.abs(gathered - expected).max() < 1e-12


def test_pairs_that_share_a_node_are_eased_one_after_the_other():
    model = glued_blocks(OPENING, columns=4)
    parts = partition(model.elements, assembly.laws(model), len(model.nodes))
    film, _ = assembly.film_arrays(model, parts)
    film.pair_upper[2] = film.pair_upper[0]
    chain_of, pairs, chains = cuda._chains(film, len(model.nodes))
    assert chain_of[int(film.pair_lower[0])] == chain_of[int(film.pair_lower[2])]
    assert sorted(np.diff(chains["pair_starts"])) == [1] * (len(pairs) - 2) + [2]
    for chain, first in enumerate(chains["pair_starts"][:-1]):
        assert (chain_of[chains["pair_lower"][first : chains["pair_starts"][chain + 1]].astype(int)] == chain).all()
    counts = np.diff(film.pair_first.astype(int))[pairs]
    assert np.array_equal(np.diff(chains["pair_first"].astype(int)), counts)


@pytest.mark.skipif(real_card(), reason="there is a card")
def test_without_a_card_a_sentence_says_so(tmp_path, capsys):
    nodes, elements, sets = lip_sheet(852)
    model = Model(nodes, elements, loads=(Fixed(sets["rim"]),), duration_s=0.01)
    with pytest.raises(InputError, match=r"expected an NVIDIA card .*, got none .*lipmetrics\[cuda\]"):
        solve(model, device="cuda")
    assert cli.main(["slow_open", "--device", "cuda", "--resolution", "low", "--out", str(tmp_path)]) == 2
    assert "NVIDIA" in capsys.readouterr().err


def test_other_devices_are_refused():
    nodes, elements, sets = lip_sheet(852)
    with pytest.raises(InputError, match="device of cpu, cuda, got 'gpu'"):
        solve(Model(nodes, elements, loads=(Fixed(sets["rim"]),), duration_s=0.01), device="gpu")


@on_a_real_card
@pytest.mark.parametrize(("precision", "limit"), [("mixed", 1e-6), ("float64", 1e-9), ("float32", 3e-4)])
def test_a_real_card_moves_as_the_processor_does(precision, limit):
    model = simulated_card.solid("press", "pull", "fall", steps=500)
    one, again = (solve(model, precision=precision, device="cuda") for _ in range(2))
    other = solve(model, precision=precision, threads=1)
    assert np.array_equal(one.positions, again.positions)
    assert np.abs(one.positions - other.positions).max() < limit * np.abs(other.displacements).max()


@on_a_real_card
def test_a_real_card_breaks_saliva_as_the_processor_does():
    model = glued_blocks(OPENING, duration_s=0.2)
    one, other = (solve(model, precision="float64", device=device) for device in ("cuda", "cpu"))
    assert set(np.unique(other.saliva.state)) == {0, 1, 2}
    assert np.abs(one.positions - other.positions).max() < 1e-6 * np.abs(other.displacements).max()


@on_a_real_card
def test_pressure_averaged_tetrahedra_are_refused():
    mesh = simulated_card.tetrahedra()
    model = Model(mesh.nodes, mesh.elements, "T4ANP", loads=mesh.loads, duration_s=0.01)
    with pytest.raises(InputError, match="T4ANP"):
        solve(model, device="cuda")
