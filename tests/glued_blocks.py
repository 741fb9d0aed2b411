"""Two blocks of tissue with a film of saliva between them: the smallest mouth."""

import numpy as np

from simulator.mesh import block
from simulator.model import Displacement, Fixed, Model, NeoHookean
from simulator.saliva import Saliva

FILM_M = 4e-4
HEIGHT_M = 0.004
TISSUE, GLUE = NeoHookean(800.0, 7000.0), NeoHookean(7700.0, 191000.0)


def glued_blocks(
    shape,
    peak_m: float = 0.002,
    strength=0.004,
    columns: int = 2,
    duration_s: float = 0.1,
    tissue=TISSUE,
    damping=20.0,
    **saliva,
) -> Model:
    """Lower block held below, upper one moved up by `peak_m` times `shape`; film in the middle.

    saliva : further settings of Saliva
    """
    nodes, elements = block((columns, 5, 1), (0.001 * columns, 1.0, 0.003))
    levels = np.array([0, HEIGHT_M / 2, HEIGHT_M, HEIGHT_M + FILM_M, 1.5 * HEIGHT_M + FILM_M, 2 * HEIGHT_M + FILM_M])
    nodes[:, 1] = levels[np.rint(nodes[:, 1] * 5).astype(int)]
    middle = nodes[elements].mean(axis=1)[:, 1]
    film = np.flatnonzero(np.abs(middle - HEIGHT_M - FILM_M / 2) < FILM_M)
    top, bottom = np.flatnonzero(nodes[:, 1] == levels[-1]), np.flatnonzero(nodes[:, 1] == 0)
    return Model(
        nodes,
        elements,
        materials=(tissue, GLUE),
        material_of=np.isin(np.arange(len(elements)), film).astype(int),
        loads=(Fixed(bottom), Fixed(top), Displacement(top, 1, peak_m, shape)),
        damping=damping,
        duration_s=duration_s,
        saliva=Saliva(film, np.tile([0.0, 1.0, 0.0], (len(film), 1)), strength, **saliva),
    )
