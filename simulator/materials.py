"""Constitutive laws: strain energy psi and first Piola-Kirchhoff stress P of a deformation gradient F.

Written in plain numpy so that each formula can be checked against its docstring. The compiled laws in
simulator/kernels.py are tested against these.

Notation: C = F^T F, J = det F, E = (C - I) / 2, S = F^-1 P (second Piola-Kirchhoff stress). F has shape (..., 3, 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError


@dataclass(frozen=True)
class NeoHookean:
    """Compressible neo-Hookean solid, with the isochoric and the volumetric part apart.

    psi = G/2 (J^(-2/3) tr C - 3) + K/2 (J - 1)^2

    P = G J^(-2/3) (F - tr C / 3 F^-T) + K J (J - 1) F^-T

    Parameters
    ----------
    shear_pa : G, shear modulus at small strain, Pa, above 0
    bulk_pa : K, bulk modulus at small strain, Pa, above 0
    density : reference density, kg/m3, above 0

    Raises
    ------
    InputError : a parameter that is not above 0
    """

    shear_pa: float
    bulk_pa: float
    density: float = 1050.0

    def __post_init__(self):
        _check_positive(self, "shear_pa", "bulk_pa", "density")

    @property
    def wave_modulus_pa(self) -> float:
        """K + 4/3 G, the modulus of pressure waves at small strain, Pa."""
        return self.bulk_pa + 4 / 3 * self.shear_pa

    @property
    def poisson(self) -> float:
        """(3K - 2G) / (6K + 2G), Poisson's ratio at small strain."""
        return (3 * self.bulk_pa - 2 * self.shear_pa) / (6 * self.bulk_pa + 2 * self.shear_pa)

    def energy(self, F: np.ndarray) -> np.ndarray:
        """psi, J/m3, shape (...)."""
        J = np.linalg.det(F)
        tr_C = np.einsum("...ij,...ij->...", F, F)
        return self.shear_pa / 2 * (J ** (-2 / 3) * tr_C - 3) + self.bulk_pa / 2 * (J - 1) ** 2

    def stress(self, F: np.ndarray) -> np.ndarray:
        """P, Pa, shape (..., 3, 3)."""
        G, K = self.shear_pa, self.bulk_pa
        J = np.linalg.det(F)[..., None, None]
        tr_C = np.einsum("...ij,...ij->...", F, F)[..., None, None]
        F_inv_T = np.swapaxes(np.linalg.inv(F), -1, -2)
        return G * J ** (-2 / 3) * (F - tr_C / 3 * F_inv_T) + K * J * (J - 1) * F_inv_T


@dataclass(frozen=True)
class StVenantKirchhoff:
    """Linear elastic solid for large rotations (NiftySim's LE): Hooke's law between S and E.

    psi = lambda/2 (tr E)^2 + mu E:E

    S = lambda tr(E) I + 2 mu E,  P = F S,  lambda = E nu / ((1 + nu)(1 - 2 nu)),  mu = E / (2 (1 + nu))

    It softens and fails under strong compression, so it is meant for comparison at small strain.

    Parameters
    ----------
    young_pa : Young's modulus, Pa, above 0
    poisson : Poisson's ratio nu, above -1 and below 0.5
    density : reference density, kg/m3, above 0

    Raises
    ------
    InputError : a parameter outside its range
    """

    young_pa: float
    poisson: float
    density: float = 1050.0

    def __post_init__(self):
        _check_positive(self, "young_pa", "density")
        if not -1 < self.poisson < 0.5:
            raise InputError(f"expected Poisson's ratio above -1 and below 0.5, got {self.poisson}")

    @property
    def shear_pa(self) -> float:
        """mu, Pa."""
        return self.young_pa / (2 * (1 + self.poisson))

    @property
    def lambda_pa(self) -> float:
        """Lame's first parameter, Pa."""
        return self.young_pa * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))

    @property
    def bulk_pa(self) -> float:
        """lambda + 2/3 mu, Pa."""
        return self.lambda_pa + 2 / 3 * self.shear_pa

    @property
    def wave_modulus_pa(self) -> float:
        """lambda + 2 mu, the modulus of pressure waves at small strain, Pa."""
        return self.lambda_pa + 2 * self.shear_pa

    def energy(self, F: np.ndarray) -> np.ndarray:
        """psi, J/m3, shape (...)."""
        E = _green_strain(F)
        tr_E = np.einsum("...ii->...", E)
        return self.lambda_pa / 2 * tr_E**2 + self.shear_pa * np.einsum("...ij,...ij->...", E, E)

    def stress(self, F: np.ndarray) -> np.ndarray:
        """P, Pa, shape (..., 3, 3)."""
        E = _green_strain(F)
        tr_E = np.einsum("...ii->...", E)[..., None, None]
        return F @ (self.lambda_pa * tr_E * np.eye(3) + 2 * self.shear_pa * E)


@dataclass(frozen=True)
class ViscoNeoHookean:
    """Neo-Hookean solid with Prony series of the isochoric and the volumetric stress (NiftySim's NHV).

    S = S_iso + S_vol - sum of h over all terms, with S_iso and S_vol the two parts of the neo-Hookean stress; a term
    (alpha, tau) of S_iso obeys tau dh/dt + h = alpha S_iso, advanced as
    h_n = tau/(dt + tau) h_(n-1) + dt alpha/(dt + tau) S_n; a term of S_vol likewise.

    Parameters
    ----------
    shear_pa, bulk_pa : instantaneous G and K, Pa, above 0
    density : reference density, kg/m3, above 0
    isochoric, volumetric : terms (alpha, relaxation time s); alphas of each part sum to less than 1

    Raises
    ------
    InputError : a parameter outside its range
    """

    shear_pa: float
    bulk_pa: float
    density: float = 1050.0
    isochoric: tuple[tuple[float, float], ...] = ()
    volumetric: tuple[tuple[float, float], ...] = ()

    def __post_init__(self):
        _check_positive(self, "shear_pa", "bulk_pa", "density")
        for name in ("isochoric", "volumetric"):
            terms = tuple((float(alpha), float(tau)) for alpha, tau in getattr(self, name))
            if (
                any(not (0 <= alpha < 1 and 0 < tau < math.inf) for alpha, tau in terms)
                or sum(a for a, _ in terms) >= 1
            ):
                raise InputError(
                    f"expected {name} terms (alpha, tau) with tau above 0 s and alphas that sum to less than 1, "
                    f"got {terms}"
                )
            object.__setattr__(self, name, terms)

    @property
    def instantaneous(self) -> NeoHookean:
        """The elastic law of a sudden deformation."""
        return NeoHookean(self.shear_pa, self.bulk_pa, self.density)

    @property
    def wave_modulus_pa(self) -> float:
        """K + 4/3 G, the modulus of pressure waves at small strain, Pa."""
        return self.instantaneous.wave_modulus_pa


Material = NeoHookean | StVenantKirchhoff | ViscoNeoHookean


def _green_strain(F: np.ndarray) -> np.ndarray:
    return (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2


def _check_positive(material: object, *names: str) -> None:
    wrong = [f"{name}={getattr(material, name)!r}" for name in names if not 0 < getattr(material, name) < math.inf]
    if wrong:
        raise InputError(f"expected {type(material).__name__} parameters above 0, got {', '.join(wrong)}")
