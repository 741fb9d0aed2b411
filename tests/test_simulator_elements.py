"""Element geometry and forces: mathematics on the slow code, then the compiled code against the slow code."""

from itertools import combinations

import numpy as np
import pytest
from meshes import ELEMENT_TYPES, distorted

from simulator import assembly, elements, kernels
from simulator.mesh import block, lip_sheet, shuffled
from simulator.model import Model, NeoHookean
from simulator.partition import partition

TISSUE = NeoHookean(800, 7000)
FACES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def arguments(model: Model) -> tuple:
    return (model.nodes, model.elements, model.element_type, model.materials, model.material_of, model.hourglass)


def inner_nodes(model: Model) -> np.ndarray:
    """Nodes of no face that belongs to one element only."""
    corners = model.elements.shape[1]
    faces = combinations(range(4), 3) if corners == 4 else FACES
    all_faces = np.concatenate([model.elements[:, list(face)] for face in faces])
    _, first, count = np.unique(np.sort(all_faces, axis=1), axis=0, return_index=True, return_counts=True)
    inner = np.ones(len(model.nodes), bool)
    inner[all_faces[first[count == 1]]] = False
    return inner


def compiled_forces(
    model: Model, u: np.ndarray, precision: str = "float64", parts: int = 1
) -> tuple[np.ndarray, float]:
    """Forces (N, 3) and lowest J of the kernels."""
    division = partition(model.elements, assembly.laws(model), len(model.nodes), parts)
    of_elements = assembly.PRECISIONS[precision][0]
    arrays = assembly.element_arrays(model, division, of_elements, 1e-4)
    nodes = assembly.node_arrays(model, division, precision, 1e-4, assembly.masses(model))
    nodes.seen[: len(u), :3] = u[division.nodes]
    lowest_J = kernels.internal_forces(arrays, nodes)
    f = np.empty_like(u)
    f[division.nodes] = nodes.forces[0, : len(u), :3]
    return f, lowest_J


@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_gradients_of_shape_functions_reproduce_affine_fields(element_type):
    rng = np.random.default_rng(0)
    model = distorted(element_type, rng)
    B = elements.shape_gradients(model.nodes, model.elements)
    assert np.abs(B.sum(axis=1)).max() < 1e-10 * np.abs(B).max()
    A = rng.normal(size=(3, 3))
    slope = np.einsum("eai,eaj->eij", (model.nodes @ A.T)[model.elements], B)
    assert np.abs(slope - A).max() < 1e-12 * np.abs(B).max()


@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_volumes_fill_the_block_and_mass_is_density_times_volume(element_type):
    model = distorted(element_type, np.random.default_rng(1), jitter=0.0)
    assert elements.volumes(model.nodes, model.elements).sum() == pytest.approx(0.03 * 0.02 * 0.04, rel=1e-12)
    assert assembly.masses(model).sum() == pytest.approx(1050 * 0.03 * 0.02 * 0.04, rel=1e-12)


def test_volume_of_a_twisted_hexahedron_is_that_of_its_trilinear_map():
    # The top face turned by 90 degrees in the plane: sections at height z are turned and shrunk squares, of area
    # (1 - z)^2 + z^2, whose integral is 2/3.
    nodes = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 1], [1, 1, 1], [0, 1, 1], [0, 0, 1.0]])
    assert elements.volumes(nodes, np.arange(8)[None]) == pytest.approx(2 / 3, rel=1e-12)


def test_gradient_of_a_hexahedron_is_the_derivative_of_its_volume_divided_by_it():
    # Flanagan and Belytschko 1981, eq. 16: integral of dN_a/dx_j over the element = dV/dx_aj.
    model = distorted("H8", np.random.default_rng(11), cells=(1, 1, 1), jitter=0.3)
    V = elements.volumes(model.nodes, model.elements)[0]
    B = elements.shape_gradients(model.nodes, model.elements)[0]
    h = 1e-4
    slope = np.empty((8, 3))
    for a in range(8):
        for j in range(3):
            moved = np.stack([model.nodes, model.nodes])
            moved[:, model.elements[0, a], j] += h, -h
            slope[a, j] = (elements.volumes(moved[0], model.elements) - elements.volumes(moved[1], model.elements))[0]
    assert np.abs(slope / (2 * h) - V * B).max() < 1e-12 * np.abs(V * B).max()  # V is linear in each coordinate


def test_rows_have_the_same_number_where_they_are_equal():
    rows = np.random.default_rng(3).integers(0, 3, (200, 4))
    equal = (rows[:, None] == rows[None]).all(axis=2)
    number = elements.row_numbers(rows)
    assert np.array_equal(number[:, None] == number[None], equal)


def test_hourglass_vectors_ignore_affine_motion():
    model = distorted("H8", np.random.default_rng(2))
    gamma = elements.hourglass_vectors(model.shape_gradients, elements.hourglass_extents(model.nodes, model.elements))
    affine = np.concatenate([np.ones((len(model.nodes), 1)), model.nodes], axis=1)[model.elements]
    assert np.abs(np.einsum("eai,eaj->eij", gamma, affine)).max() < 1e-13


@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_patch_test_an_affine_motion_leaves_inner_nodes_in_balance(element_type):
    rng = np.random.default_rng(3)
    model = distorted(element_type, rng, cells=(4, 4, 4), materials=(TISSUE,))
    u = model.nodes @ (rng.uniform(-0.3, 0.3, (3, 3))).T
    for f in (elements.internal_forces(*arguments(model), u), compiled_forces(model, u)[0]):
        inner = inner_nodes(model)
        assert inner.sum() >= 27
        assert np.abs(f[inner]).max() < 1e-12 * np.abs(f).max()


@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_rigid_rotation_needs_no_force(element_type):
    rng = np.random.default_rng(4)
    model = distorted(element_type, rng)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    turned = model.nodes @ Q.T - model.nodes
    stretched = 0.1 * model.nodes
    scale = np.abs(compiled_forces(model, stretched)[0]).max()
    for f in (elements.internal_forces(*arguments(model), turned), compiled_forces(model, turned)[0]):
        assert np.abs(f).max() < 1e-12 * scale


@pytest.mark.parametrize("element_type", ["H8", "T4"])
def test_force_is_the_derivative_of_the_energy(element_type):
    rng = np.random.default_rng(5)
    model = distorted(element_type, rng)
    u = rng.normal(0, 5e-4, model.nodes.shape)
    f, _ = compiled_forces(model, u)
    direction = rng.normal(size=u.shape)
    direction /= np.abs(direction).max()
    h = 2e-5

    def energy(step):
        return sum(one.sum() for one in elements.strain_energies(*arguments(model), u + step * direction))

    one, two, three = (energy(k * h) - energy(-k * h) for k in (1, 2, 3))
    slope = (45 * one - 9 * two + three) / (60 * h)  # order 6
    assert slope == pytest.approx(np.sum(f * direction), rel=1e-9)


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
def test_compiled_forces_equal_the_plain_ones(element_type, parts):
    rng = np.random.default_rng(6)
    model = distorted(element_type, rng)
    u = rng.normal(0, 8e-4, model.nodes.shape)
    expected = elements.internal_forces(*arguments(model), u)
    f, lowest_J = compiled_forces(model, u, parts=parts)
    assert np.abs(f - expected).max() < 1e-13 * np.abs(expected).max()
    if element_type != "T4ANP":
        F = elements.deformation_gradients(model.nodes, model.elements, u)
        assert lowest_J == pytest.approx(np.linalg.det(F).min(), rel=1e-12)


@pytest.mark.parametrize("jumbled", [False, True])
def test_rows_of_a_sheet_give_the_same_forces_in_any_numbering(jumbled):
    rng = np.random.default_rng(7)
    nodes, cells, _ = lip_sheet(852)
    if jumbled:
        nodes, cells, _ = shuffled(nodes, cells, rng)
    model = Model(nodes, cells)
    division = partition(model.elements, assembly.laws(model), len(nodes))
    assert assembly.element_arrays(model, division, np.float32, 1e-4).run.mean() > 0.93  # rows are used
    u = rng.normal(0, 1e-4, nodes.shape)
    expected = elements.internal_forces(*arguments(model), u)
    f, _ = compiled_forces(model, u, "mixed", parts=2)
    assert np.abs(f - expected).max() < 1e-5 * np.abs(expected).max()


def test_swept_elements_are_told_from_others_and_give_the_plain_forces():
    rng = np.random.default_rng(11)
    nodes, cells = block((9, 4, 3), (0.09, 0.04, 0.03))
    x, y = nodes[:, 0].copy(), nodes[:, 1].copy()
    # Every layer is the same warped face, moved along a slanting line; then the last layer becomes uneven.
    nodes += np.stack([0.3 * nodes[:, 2] + 3 * x * y, 2 * y * y - 4 * x * y, 5 * x * y + 6 * x * x], axis=1)
    uneven = nodes + np.where(nodes[:, 2:] > nodes[:, 2:].max() - 1e-9, 0.001, 0.0)
    for points, all_swept in ((nodes, True), (uneven, False)):
        model = Model(points, cells)
        u = rng.normal(0, 5e-4, points.shape)
        division = partition(model.elements, assembly.laws(model), len(points), 1)
        swept = assembly.element_arrays(model, division, np.float64, 1e-4).swept
        assert swept.all() if all_swept else 0 < swept.mean() < 1
        expected = elements.internal_forces(*arguments(model), u)
        assert np.abs(compiled_forces(model, u)[0] - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("element_type", ["H8", "T4"])
def test_compiled_energies_equal_the_plain_ones(element_type):
    rng = np.random.default_rng(8)
    model = distorted(element_type, rng)
    u = rng.normal(0, 8e-4, model.nodes.shape)
    expected = [one.sum() for one in elements.strain_energies(*arguments(model), u)]
    assert kernels.strain_energies(*assembly.energy_arrays(model), u) == pytest.approx(expected, rel=1e-12)


def test_an_element_turned_inside_out_shows_in_the_lowest_volume_ratio():
    model = distorted("H8", np.random.default_rng(9), jitter=0.0)
    u = np.zeros_like(model.nodes)
    u[-1] = -0.05
    assert compiled_forces(model, u)[1] <= 0
    u[-1] = np.nan
    assert compiled_forces(model, u)[1] <= 0


def test_area_stretch_is_the_largest_singular_value_of_the_cofactor():
    rng = np.random.default_rng(10)
    model = distorted("T4", rng)
    u = rng.normal(0, 8e-4, model.nodes.shape)
    F = elements.deformation_gradients(model.nodes, model.elements, u)
    cofactor = np.linalg.det(F)[:, None, None] * np.linalg.inv(F)
    expected = np.linalg.svd(cofactor, compute_uv=False).max()
    assert kernels.largest_area_stretch(*assembly.energy_arrays(model)[:3], u) == pytest.approx(expected, rel=1e-9)
