"""Structured meshes: counts, volumes, and tetrahedra that fit together."""

import numpy as np
import pytest

from simulator.elements import volumes
from simulator.errors import InputError
from simulator.mesh import SHEET_CELLS, block, lip_sheet, shuffled, to_tetrahedra
from simulator.model import Model


@pytest.mark.parametrize("per_cell", [5, 6])
def test_tetrahedra_fill_the_block_and_share_their_faces(per_cell):
    nodes, hexahedra = block((3, 2, 4), (1.0, 2.0, 3.0))
    tetrahedra = to_tetrahedra(nodes, hexahedra, per_cell)
    assert len(tetrahedra) == 24 * per_cell
    assert volumes(nodes, tetrahedra).min() > 0
    assert volumes(nodes, tetrahedra).sum() == pytest.approx(6.0, rel=1e-12)
    faces = np.concatenate([tetrahedra[:, f] for f in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])])
    _, count = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    assert (count == 1).sum() == 2 * 2 * (3 * 2 + 2 * 4 + 3 * 4)  # two triangles per outer square
    assert count.max() == 2


@pytest.mark.parametrize("elements", SHEET_CELLS)
def test_sheets_have_the_sizes_of_the_thesis_and_a_slit(elements):
    nodes, cells, sets = lip_sheet(elements)
    assert abs(len(cells) / elements - 1) < 0.05
    model = Model(nodes, cells)  # which checks volumes and that every node is used
    upper, lower = sets["upper"], sets["lower"]
    assert np.array_equal(model.nodes[upper], model.nodes[lower])
    touching = [set(np.flatnonzero(np.isin(cells, side).any(axis=1))) for side in (upper, lower)]
    assert not touching[0] & touching[1]


def test_shuffling_keeps_the_shape():
    nodes, cells, _ = lip_sheet(852)
    jumbled, elements, number = shuffled(nodes, cells, np.random.default_rng(0))
    assert np.array_equal(jumbled[number], nodes)
    centres = [np.sort(x[e].mean(axis=1), axis=0) for x, e in ((nodes, cells), (jumbled, elements))]
    assert np.allclose(*centres, rtol=0, atol=1e-15)


def test_impossible_blocks_are_refused():
    with pytest.raises(InputError, match="cells of 1 or more"):
        block((0, 1, 1), (1, 1, 1))
    with pytest.raises(InputError, match="5 or 6 tetrahedra"):
        to_tetrahedra(*block((1, 1, 1), (1, 1, 1)), 7)
    with pytest.raises(InputError, match="expected a sheet of 852, 3414, 13680"):
        lip_sheet(1000)
