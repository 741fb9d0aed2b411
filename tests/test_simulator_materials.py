"""Constitutive laws: stress is the derivative of energy, small-strain limits, rotations."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.materials import NeoHookean, StVenantKirchhoff, ViscoNeoHookean

LAWS = [NeoHookean(800, 7000), NeoHookean(7700, 191000), StVenantKirchhoff(2311.9, 0.445)]


def rotation(rng) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_stress_is_the_derivative_of_the_energy(law):
    rng = np.random.default_rng(0)
    F = np.eye(3) + rng.uniform(-0.3, 0.3, (20, 3, 3))
    P = law.stress(F)
    by_differences = np.zeros_like(P)
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3))
            step[i, j] = 1e-3
            # Differences of order 4.
            one, two = (law.energy(F + k * step) - law.energy(F - k * step) for k in (1, 2))
            by_differences[:, i, j] = (8 * one - two) / (12 * 1e-3)
    assert np.abs(P - by_differences).max() < 1e-7 * np.abs(P).max()


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_rest_is_free_of_stress_and_energy(law):
    assert law.energy(np.eye(3)) == 0
    assert np.abs(law.stress(np.eye(3))).max() < 1e-12 * law.wave_modulus_pa


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_rotating_after_deforming_turns_the_stress(law):
    rng = np.random.default_rng(1)
    F, Q = np.eye(3) + rng.uniform(-0.2, 0.2, (3, 3)), rotation(rng)
    assert np.allclose(law.stress(Q @ F), Q @ law.stress(F), rtol=1e-12, atol=1e-9)
    assert law.energy(Q @ F) == pytest.approx(law.energy(F), rel=1e-12)


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_small_strain_is_hookes_law(law):
    strain = 1e-6 * np.array([[1, 2, 0], [2, -1, 3], [0, 3, 2.0]])
    hooke = 2 * law.shear_pa * strain + (law.bulk_pa - 2 / 3 * law.shear_pa) * np.trace(strain) * np.eye(3)
    assert np.abs(law.stress(np.eye(3) + strain) - hooke).max() < 1e-4 * np.abs(hooke).max()


def test_tissue_is_nearly_incompressible_and_saliva_more_so():
    assert NeoHookean(800, 7000).poisson == pytest.approx(0.445, abs=5e-4)
    assert NeoHookean(7700, 191000).poisson == pytest.approx(0.480, abs=5e-4)


def test_neo_hookean_in_simple_shear_has_stress_in_proportion_to_shear():
    # A textbook result: sigma_xy = G gamma at any shear, as J stays 1.
    F = np.eye(3)
    F[0, 1] = 0.7
    law = NeoHookean(800, 7000)
    assert (law.stress(F) @ F.T)[0, 1] == pytest.approx(800 * 0.7, rel=1e-12)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: NeoHookean(0, 7000), "NeoHookean parameters above 0, got shear_pa=0"),
        (lambda: NeoHookean(800, float("nan")), "bulk_pa=nan"),
        (lambda: StVenantKirchhoff(1000, 0.5), "below 0.5, got 0.5"),
        (lambda: ViscoNeoHookean(800, 7000, 1050, ((0.7, 0.1), (0.4, 0.1))), "sum to less than 1"),
        (lambda: ViscoNeoHookean(800, 7000, 1050, (), ((0.3, 0.0),)), "tau above 0 s"),
    ],
)
def test_impossible_parameters_are_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()
