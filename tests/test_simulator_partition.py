"""The division of a mesh: every element once, every node once, no node advanced before all its forces are there."""

import numpy as np
import pytest
from meshes import ELEMENT_TYPES, distorted

from simulator import assembly
from simulator.mesh import block, lip_sheet, shuffled
from simulator.partition import partition


def check(elements, division, n_nodes):
    visited = division.elements[division.elements >= 0]
    assert np.array_equal(np.sort(visited), np.arange(len(elements)))
    assert np.array_equal(np.sort(division.nodes), np.arange(n_nodes))
    stored_at = np.argsort(division.nodes)
    parts = len(division.node_starts) - 1
    for q in range(parts):
        mine = division.elements[division.element_starts[q] : division.element_starts[q + 1]]
        touched = np.unique(stored_at[elements[mine[mine >= 0]]])
        covered = np.concatenate([np.arange(*division.touched[p, q]) for p in range(parts)])
        assert np.isin(touched, covered).all()
        for p in range(parts):
            first, last = division.touched[p, q]
            assert first == last or division.node_starts[p] <= first < last <= division.node_starts[p + 1]
    for p in range(parts):  # a part adds up what later parts left on its nodes, so earlier ones must leave nothing
        assert all(division.touched[p, q, 0] == division.touched[p, q, 1] for q in range(p))


@pytest.mark.parametrize("parts", [1, 2, 4])
@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_blocks(element_type, parts):
    model = distorted(element_type, np.random.default_rng(0), cells=(5, 4, 6))
    check(model.elements, partition(model.elements, assembly.laws(model), len(model.nodes), parts), len(model.nodes))


@pytest.mark.parametrize("jumbled", [False, True])
def test_a_sheet_is_visited_in_rows_whatever_its_numbers(jumbled):
    nodes, elements, _ = lip_sheet(852)
    if jumbled:
        nodes, elements, _ = shuffled(nodes, elements, np.random.default_rng(1))
    division = partition(elements, np.zeros(len(elements), int), len(nodes), 2)
    check(elements, division, len(nodes))


def test_laws_do_not_share_a_batch():
    _, elements = block((5, 5, 5), (1, 1, 1))
    law = np.random.default_rng(2).integers(0, 3, len(elements))
    division = partition(elements, law, 216, 2)
    check(elements, division, 216)
    for batch in range(0, len(division.elements), 8):
        members = division.elements[batch : batch + 8]
        assert len(np.unique(law[members[members >= 0]])) == 1


def test_a_ring_of_elements_is_broken_open_somewhere():
    around = 20
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    corners = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(around, z)], 1) for z in (0, 1) for r in (1, 2)]
    inner, outer, inner_up, outer_up = (np.arange(around) + around * k for k in range(4))
    elements = np.stack(
        [
            *(inner, np.roll(inner, -1), np.roll(outer, -1), outer),
            *(inner_up, np.roll(inner_up, -1), np.roll(outer_up, -1), outer_up),
        ],
        axis=1,
    )
    nodes = np.concatenate(corners)
    check(elements, partition(elements, np.zeros(around, int), len(nodes), 2), len(nodes))
