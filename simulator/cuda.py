"""The steps between two saved states on an NVIDIA card, all in one launch.

The laws are those of kernels.py and film.py: `_Twins` compiles the same Python functions for the card. A batch of
elements is there one block's threads, a lane each, and simd.py's vectors are single numbers; of saliva and loads each
element, pair, face or node is a part of its own, with a thread to itself.

Each step is two phases. First every element, strut and face leaves its forces in places of its own; then every node
gathers them in a fixed order and moves. Nothing is added up in an order that chance decides, so that runs are equal to
the bit on cards of one kind. Only the running sums of the energy ledger depend on the number of blocks.
"""

from __future__ import annotations

import functools
from types import FunctionType
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from simulator import film as saliva
from simulator import kernels, simd
from simulator.errors import InputError
from simulator.film import ease_film, pull_film
from simulator.kernels import _h8_forces, _move_nodes, _push_faces, _push_nodes, _t4_forces, damping_loss, verdict

try:
    from numba import config, cuda
    from numba.cuda import libdevice
except ImportError:  # a numba without CUDA
    cuda = None

# Of a block; fewer in numba's simulator, where each is a thread of the processor.
THREADS = 32 if cuda and config.ENABLE_CUDASIM else 256
CACHED = not (cuda and config.ENABLE_CUDASIM)  # what is compiled, for later processes
FEW_ELEMENTS = 8000  # up to which a block takes a quarter of its threads' number of elements, above it half
ROUND = 4  # places that a node reads at once

# Places of this module's functions that `_Twins` fills: precision of elements and of nodal sums, elements of a batch,
# and the size of the scratch that a batch needs.
REAL, SUM, LANES, SCRATCH = np.float32, np.float64, 0, 0

SUMS = kernels.GLUE + 1  # of a step over all nodes, in the order of kernels' stats
REASON, STEPS_DONE = range(2)


class Nodes(NamedTuple):
    """What kernels.Nodes has, but all forces in one place (M, 4), in the precision of the nodal sums."""

    seen: np.ndarray
    forces: np.ndarray
    rest: np.ndarray
    u: np.ndarray
    du: np.ndarray
    compliance: np.ndarray
    mass: np.ndarray


class Plan(NamedTuple):
    """Who does what, and the places in between.

    forces : (3, C) forces on corners of elements in the order of `H8Elements.numbers`, ends of struts, faces; last 0
    of_struts, of_faces : (3, 8 F + 1) and (3, S + 1) windows of it
    order : (N,) stored nodes, those of block b from node_starts[b] (G + 1,) on
    places : (R, N) places in `forces` of what acts on each node of `order`; used : (N,) how many, whole rounds
    loaded : (N,) 1 where nodal forces or prescribed displacements act on a node of `order`
    chain_starts : (G + 1,) first chain of pairs of each block; a chain's nodes are of one block
    sums : (SUMS, G) of each block's step
    heavy : 1 where gravity acts on all nodes
    """

    forces: np.ndarray
    of_struts: np.ndarray
    of_faces: np.ndarray
    order: np.ndarray
    node_starts: np.ndarray
    places: np.ndarray
    used: np.ndarray
    loaded: np.ndarray
    chain_starts: np.ndarray
    sums: np.ndarray
    heavy: int


def check() -> None:
    """Refuse where there is no card to compute on."""
    if cuda is None or not cuda.is_available():
        raise InputError(
            'expected an NVIDIA card for device "cuda", got none that numba-cuda can use; install its driver and '
            "`pip install 'lipmetrics[cuda]'`, or compute on the processor, device \"cpu\""
        )


# ---- simd.py with one lane per thread -------------------------------------------------------------------------------


def _mine(start):
    """Where a thread's lane of the vector from `start` on is; unsigned, as no index counts from the end."""
    return np.uintp(start) + np.uintp(cuda.threadIdx.x)


def _lanes(array):
    return LANES


def _load(array, start):
    return array[_mine(start)]


def _store(array, start, value):
    array[_mine(start)] = value


def _zero(array):
    return REAL(0.0)


def _splat(like, value):
    return REAL(value)


def _gather(records, starts, start, run):
    node = np.uintp(starts[_mine(start)]) // np.uintp(4)
    return records[node, 0], records[node, 1], records[node, 2], records[node, 3]


def _scatter_add(forces, starts, start, x, y, z, w):
    """To the corner's own place, where nothing is yet."""
    place = _mine(start)
    forces[0, place], forces[1, place], forces[2, place] = x, y, z


def _scatter_add_line(forces, starts, a, b, run, xa, ya, za, xb, yb, zb):
    _scatter_add(forces, starts, a, xa, ya, za, xa)
    _scatter_add(forces, starts, b, xb, yb, zb, xb)


def _poison_unless_positive(low, value):
    if value > low:
        return low
    return value if value > 0 else REAL(-1.0)


def _lowest(value):
    return value


def _inverse_cbrt_float32(x):
    return libdevice.rcbrtf(x)


def _inverse_cbrt_float64(x):
    return libdevice.rcbrt(x)


def _inverse_cbrt_simulated(x):
    return x ** (-1.0 / 3.0)


# ---- forces in places of their own ----------------------------------------------------------------------------------


def _forces_of(nodes, part):
    return nodes.forces


def _add_to_ends(places, f, k, low, up, axis, of_low, of_up):
    places[axis, 8 * f + 2 * k] = of_low
    places[axis, 8 * f + 2 * k + 1] = of_up


def _press_node(places, s, node, fx, fy, fz):
    places[0, s], places[1, s], places[2, s] = -fx, -fy, -fz


def _of_hexahedra(elements, block, seen, forces, scratch):
    return _h8_forces(elements, block, seen, forces, scratch)


def _of_tetrahedra(elements, block, seen, forces, scratch):
    return _t4_forces(elements, block, seen, forces, False)


def _element_forces(elements, block, seen, forces, scratch):
    """Stands for one of the two."""


# ---- steps ----------------------------------------------------------------------------------------------------------


def _meet():
    """Wait for all threads of all blocks."""
    cuda.cg.this_grid().sync()


def _gathered(plan, i):
    """What all elements, struts and faces leave on node i of the order."""
    x, y, z = SUM(0.0), SUM(0.0), SUM(0.0)
    for k in range(0, plan.used[i], ROUND):
        a, b, c, d = plan.places[k, i], plan.places[k + 1, i], plan.places[k + 2, i], plan.places[k + 3, i]
        x += (SUM(plan.forces[0, a]) + SUM(plan.forces[0, b])) + (SUM(plan.forces[0, c]) + SUM(plan.forces[0, d]))
        y += (SUM(plan.forces[1, a]) + SUM(plan.forces[1, b])) + (SUM(plan.forces[1, c]) + SUM(plan.forces[1, d]))
        z += (SUM(plan.forces[2, a]) + SUM(plan.forces[2, b])) + (SUM(plan.forces[2, c]) + SUM(plan.forces[2, d]))
    return x, y, z


def _loaded(plan, loads, nodes, i, n, x, y, z, curves, gravity, at):
    """Forces on node n, the i-th of the order, with its loads; and their work over the last increment."""
    work = 0.0
    if plan.loaded[i] != 0:
        nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2] = x, y, z
        work += _push_nodes(loads, nodes, n, curves, at)
        x, y, z = nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2]
    if plan.heavy != 0:
        m = nodes.mass[n]
        x -= SUM(m * gravity[at, 0])
        y -= SUM(m * gravity[at, 1])
        z -= SUM(m * gravity[at, 2])
        work += 0.5 * m * (gravity[at - 1, 0] + gravity[at, 0]) * nodes.du[n, 0]
        work += 0.5 * m * (gravity[at - 1, 1] + gravity[at, 1]) * nodes.du[n, 1]
        work += 0.5 * m * (gravity[at - 1, 2] + gravity[at, 2]) * nodes.du[n, 2]
    return x, y, z, work


def _moved(plan, loads, nodes, i, n, x, y, z, curves, at, scheme):
    """Where displacements are prescribed, what brings to place instead of forces; and the constraints' work."""
    if plan.loaded[i] == 0:
        return x, y, z, 0.0
    nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2] = x, y, z
    work = _move_nodes(loads, nodes, n, curves, at, scheme[0], scheme[1], scheme[2])
    return nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2], work


def _advance_node(nodes, n, keep, x, y, z):
    """kernels._advance_nodes of one node: du <- keep du - compliance f, u <- u + du; its sums."""
    m, keep = nodes.mass[n], SUM(keep)
    old_x, old_y, old_z = nodes.du[n, 0], nodes.du[n, 1], nodes.du[n, 2]
    new_x = keep * old_x - nodes.compliance[n, 0] * x
    new_y = keep * old_y - nodes.compliance[n, 1] * y
    new_z = keep * old_z - nodes.compliance[n, 2] * z
    u_x, u_y, u_z = nodes.u[n, 0] + new_x, nodes.u[n, 1] + new_y, nodes.u[n, 2] + new_z
    nodes.du[n, 0], nodes.du[n, 1], nodes.du[n, 2] = new_x, new_y, new_z
    nodes.u[n, 0], nodes.u[n, 1], nodes.u[n, 2] = u_x, u_y, u_z
    nodes.seen[n, 0], nodes.seen[n, 1], nodes.seen[n, 2] = u_x, u_y, u_z
    return m * (new_x * new_x + new_y * new_y + new_z * new_z), m * (new_x * old_x + new_y * old_y + new_z * old_z)


def _fold(sums, thread):
    """Add up the rows of (SUMS, THREADS), of LOWEST_J take the least; the result is in the first column."""
    width = THREADS // 16
    cuda.syncthreads()
    row, column = thread // width, thread % width
    if row < SUMS:
        value = sums[row, column]
        for i in range(column + width, THREADS, width):
            value = min(value, sums[row, i]) if row == kernels.LOWEST_J else value + sums[row, i]
        sums[row, column] = value
    cuda.syncthreads()
    if thread < SUMS:
        value = sums[thread, 0]
        for i in range(1, width):
            value = min(value, sums[thread, i]) if thread == kernels.LOWEST_J else value + sums[thread, i]
        sums[thread, 0] = value
    cuda.syncthreads()


def _balance(plan, sums, thread, step, scheme, ledger, log, outcome):
    """One block closes the books of a step, as the end of kernels.advance does; it says whether to go on."""
    for row in range(SUMS):
        value = 1e30 if row == kernels.LOWEST_J else 0.0
        for block in range(thread, plan.sums.shape[1], THREADS):
            one = plan.sums[row, block]
            value = min(value, one) if row == kernels.LOWEST_J else value + one
        sums[row, thread] = value
    _fold(sums, thread)
    if thread == 0:
        low, work, glue = sums[kernels.LOWEST_J, 0], sums[kernels.WORK, 0], sums[kernels.GLUE, 0]
        square, product = sums[kernels.SQUARE, 0], sums[kernels.PRODUCT, 0]
        damping, dt, tolerance, floor = scheme[1], scheme[2], scheme[3], scheme[4]
        rescale = ledger[5]
        kinetic = product / (2.0 * dt * dt)
        lost = ledger[0] + damping_loss(rescale, damping, dt, ledger[3], product, ledger[4])
        done_work = ledger[1] + rescale * work
        glued = ledger[6] + rescale * glue
        most = max(ledger[2], done_work)
        ledger[0], ledger[1], ledger[2], ledger[3], ledger[4] = lost, done_work, most, square, product
        ledger[5], ledger[6] = 1.0, glued
        log[kernels.LOG_KINETIC, step], log[kernels.LOG_DAMPING, step] = kinetic, lost
        log[kernels.LOG_EXTERNAL, step], log[kernels.LOG_LOWEST_J, step] = done_work, low
        log[kernels.LOG_SALIVA, step] = glued
        outcome[STEPS_DONE] = step + 1
        outcome[REASON] = verdict(kinetic + lost, tolerance * most + floor, low)


def _steps(elements, nodes, loads, film, plan, curves, gravity, column, steps, scheme, ledger, log, outcome):
    """kernels.advance for a whole grid of blocks of THREADS threads; the last block keeps the books.

    The books of a step are closed while the next one's forces are being worked out, so that of the step after one that
    went wrong only the forces have been, and what saliva and faces remember of them.

    scheme, ledger, log : as in kernels.advance
    outcome : (2,) REASON and STEPS_DONE, filled
    """
    scratch = cuda.shared.array(SCRATCH, REAL)
    sums = cuda.shared.array((SUMS, THREADS), np.float64)
    block, thread, blocks = cuda.blockIdx.x, cuda.threadIdx.x, cuda.gridDim.x
    workers = max(blocks - 1, 1)
    keep, dt = scheme[0], scheme[2]
    of_struts = Nodes(nodes.seen, plan.of_struts, nodes.rest, nodes.u, nodes.du, nodes.compliance, nodes.mass)
    of_faces = Nodes(nodes.seen, plan.of_faces, nodes.rest, nodes.u, nodes.du, nodes.compliance, nodes.mass)
    first, last = plan.node_starts[block], plan.node_starts[block + 1]
    first_chain, last_chain = plan.chain_starts[block], plan.chain_starts[block + 1]
    # Threads that have no element take struts, one of each warp first, and from the other end faces.
    spare = THREADS - LANES
    warps = spare // 32 if spare >= 32 else 1
    rank = (thread - LANES) % (spare // warps) * warps + (thread - LANES) // (spare // warps)
    for step in range(steps):
        at = column + step
        low, work, glue = 1e30, 0.0, 0.0
        if thread < LANES:
            low = np.float64(_element_forces(elements, block, nodes.seen, plan.forces, scratch))
        elif block < workers:
            for f in range(block + workers * rank, len(film.area), workers * spare):
                for end in range(8):
                    plan.of_struts[0, 8 * f + end] = 0.0
                    plan.of_struts[1, 8 * f + end] = 0.0
                    plan.of_struts[2, 8 * f + end] = 0.0
                glue += pull_film(film, of_struts, f, step * dt, dt)
            for s in range(block + workers * (spare - 1 - rank), len(loads.face_pa), workers * spare):
                work += _push_faces(loads, of_faces, s, curves, at)
        if step > 0 and block == blocks - 1:
            _balance(plan, sums, thread, step - 1, scheme, ledger, log, outcome)
        _meet()
        if outcome[REASON] != kernels.DONE:
            break

        square, product = 0.0, 0.0
        if first_chain == last_chain:
            for i in range(first + thread, last, THREADS):
                n = plan.order[i]
                x, y, z = _gathered(plan, i)
                x, y, z, pushed = _loaded(plan, loads, nodes, i, n, x, y, z, curves, gravity, at)
                x, y, z, moved = _moved(plan, loads, nodes, i, n, x, y, z, curves, at, scheme)
                of_square, of_product = _advance_node(nodes, n, keep, x, y, z)
                work += pushed + moved
                square += of_square
                product += of_product
        else:
            for i in range(first + thread, last, THREADS):
                n = plan.order[i]
                x, y, z = _gathered(plan, i)
                x, y, z, pushed = _loaded(plan, loads, nodes, i, n, x, y, z, curves, gravity, at)
                nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2] = x, y, z
                work += pushed
            cuda.syncthreads()
            for chain in range(first_chain + thread, last_chain, THREADS):
                glue += ease_film(film, nodes, chain, keep, dt)
            cuda.syncthreads()
            for i in range(first + thread, last, THREADS):
                n = plan.order[i]
                x, y, z = nodes.forces[n, 0], nodes.forces[n, 1], nodes.forces[n, 2]
                x, y, z, moved = _moved(plan, loads, nodes, i, n, x, y, z, curves, at, scheme)
                of_square, of_product = _advance_node(nodes, n, keep, x, y, z)
                work += moved
                square += of_square
                product += of_product
        sums[kernels.SQUARE, thread], sums[kernels.PRODUCT, thread] = square, product
        sums[kernels.LOWEST_J, thread], sums[kernels.WORK, thread], sums[kernels.GLUE, thread] = low, work, glue
        _fold(sums, thread)
        if thread < SUMS:
            plan.sums[thread, block] = sums[thread, 0]
        _meet()
    if outcome[REASON] == kernels.DONE and block == blocks - 1:
        _balance(plan, sums, thread, steps - 1, scheme, ledger, log, outcome)


# ---- the same functions for the card --------------------------------------------------------------------------------


class _Twins:
    """Compiles functions that are compiled for the processor, or plain ones, for the card.

    A twin has the same code and sees the twins of what the first one calls. Numbers written in kernels.py become those
    of the elements' precision, as its vectors make them, since numba would go on in double precision.
    """

    def __init__(self, real: type, total: type, lanes: int, tetrahedra: bool):
        self.real = real
        inverse_cbrt = {np.float32: _inverse_cbrt_float32, np.float64: _inverse_cbrt_float64}[real]
        self.instead = {
            simd.lanes: _lanes,
            simd.load: _load,
            simd.store: _store,
            simd.zero: _zero,
            simd.splat: _splat,
            simd.gather: _gather,
            simd.scatter_add: _scatter_add,
            simd.scatter_add_line: _scatter_add_line,
            simd.poison_unless_positive: _poison_unless_positive,
            simd.lowest: _lowest,
            simd.inverse_cbrt: _inverse_cbrt_simulated if config.ENABLE_CUDASIM else inverse_cbrt,
            saliva.forces_of: _forces_of,
            saliva._add_to_ends: _add_to_ends,
            kernels._press_node: _press_node,
            _element_forces: _of_tetrahedra if tetrahedra else _of_hexahedra,
        }
        own = {"REAL": real, "SUM": total, "LANES": lanes, "SCRATCH": kernels.KEPT * lanes}
        self.spaces = {id(globals()): globals() | own, id(vars(kernels)): vars(kernels) | {"GROUP": 1}}
        self.made = {}

    def of(self, function):
        """The twin of a function."""
        function = self.instead.get(function, function)
        python = getattr(function, "py_func", function)
        if python not in self.made:
            self.made[python] = _for_device(self.plain(python))
        return self.made[python]

    def plain(self, python: FunctionType) -> FunctionType:
        """The function not yet compiled, its callees twins."""
        names = self.spaces.setdefault(id(python.__globals__), dict(python.__globals__))
        code = python.__code__
        for name in code.co_names:
            value = python.__globals__.get(name)
            if hasattr(value, "py_func") or (isinstance(value, FunctionType) and _is_ours(value)):
                names[name] = self.of(value)
        if python.__module__ == kernels.__name__:
            code = code.replace(co_consts=tuple(self.real(c) if type(c) is float else c for c in code.co_consts))
        return FunctionType(code, names, python.__name__, python.__defaults__)


def _is_ours(function: FunctionType) -> bool:
    return function.__module__ in (__name__, kernels.__name__, saliva.__name__, simd.__name__)


def _for_device(function: FunctionType):
    if config.ENABLE_CUDASIM:
        return function  # plain Python, as the kernel that calls it is
    # A function of the card cannot hand back an array, unless numba puts its code in place of the call.
    return cuda.jit(device=True, inline="always" if function.__name__ == _forces_of.__name__ else "never")(function)


@functools.cache
def _kernel(real: type, total: type, lanes: int, tetrahedra: bool):
    """The kernel `_steps` for elements and nodal sums of these types; compiled at its first launch on a machine."""
    steps = _Twins(real, total, lanes, tetrahedra).plain(_steps)
    steps.__qualname__ += f"_{real.__name__}_{total.__name__}_{lanes}_{tetrahedra}"  # names its place in numba's cache
    return cuda.jit(cache=CACHED)(steps)


# ---- from the processor's side --------------------------------------------------------------------------------------


def lanes_for(elements: int) -> int:
    """Elements of a batch, for a mesh of so many."""
    return THREADS // 4 if elements <= FEW_ELEMENTS else THREADS // 2


def blocks_for(elements: int, nodes: int, struts: int) -> int:
    """Blocks that share a mesh out, of which the last only keeps the books: no more than can all run at once."""
    if config.ENABLE_CUDASIM:
        return 1
    most = cuda.get_current_device().MULTIPROCESSOR_COUNT
    return max(2, min(most, 1 + max(-(-elements // lanes_for(elements)), -(-nodes // THREADS), -(-struts // 16))))


class Steps:
    """A run's arrays on the card, and its steps.

    Parameters
    ----------
    elements : in batches of `lanes_for` elements, shared out to `workers(blocks)` parts
    nodes, loads, film : as the processor's kernels have them; what steps change there is brought up to date after them
    blocks : as of `blocks_for`
    heavy : whether gravity acts on all nodes
    """

    def __init__(self, elements, nodes, loads, film, count: int, blocks: int, heavy: bool):
        if isinstance(elements, kernels.T4ANPElements):
            raise InputError(
                'expected hexahedra or T4 tetrahedra for device "cuda", got T4ANP; compute these on the processor, '
                'device "cpu"'
            )
        self.elements, self.nodes, self.loads, self.film = elements, nodes, loads, film
        self.blocks = blocks
        self.changed = True  # on the processor's side
        self._tables = None
        total = nodes.u.dtype
        plan, self._pairs, chains = _plan(elements, nodes, loads, film, count, blocks, heavy)
        lanes = elements.numbers.size // elements.law.size // (8 if isinstance(elements, kernels.H8Elements) else 4)
        self._kernel = _kernel(
            elements.constants.dtype.type, total.type, lanes, isinstance(elements, kernels.T4Elements)
        )
        up = cuda.to_device
        starts = np.append(elements.starts, elements.starts[-1])  # none for the last block, unless it is the only one
        self._elements = type(elements)(*(up(a) if isinstance(a, np.ndarray) else a for a in elements))._replace(
            starts=up(starts)
        )
        self._nodes = Nodes(
            up(nodes.seen),
            up(np.zeros_like(nodes.u)),
            up(nodes.rest),
            up(nodes.u),
            up(nodes.du),
            up(nodes.compliance),
            up(nodes.mass),
        )
        of_nodes = 4 * np.arange(count + 1)
        self._loads = kernels.Loads(*map(up, loads))._replace(
            force_starts=up(np.searchsorted(loads.force_dof, of_nodes)),
            moved_starts=up(np.searchsorted(loads.moved_dof, of_nodes)),
            face_starts=up(np.arange(len(loads.face_pa) + 1)),
        )
        self._film = type(film)(*(up(a) if isinstance(a, np.ndarray) else a for a in film))._replace(
            starts=up(np.arange(len(film.area) + 1)), **{name: up(values) for name, values in chains.items()}
        )
        on_card = {name: up(a) if isinstance(a, np.ndarray) else a for name, a in plan._asdict().items()}
        corners, struts, faces = plan.forces.shape[1], plan.of_struts.shape[1], plan.of_faces.shape[1]
        on_card["of_struts"] = on_card["forces"][:, corners - 1 - faces - struts : corners - 1 - faces]
        on_card["of_faces"] = on_card["forces"][:, corners - 1 - faces : corners - 1]
        self._plan = Plan(**on_card)
        self._ledger, self._outcome = up(kernels.LEDGER), up(np.zeros(2, np.int64))
        self._log = None

    def advance(self, curves, gravity, column: int, steps: int, scheme, ledger, log) -> tuple[int, int]:
        """As kernels.advance, by all of the card; `ledger`, `log` and the run's arrays are brought up to date."""
        if steps == 0:
            return kernels.DONE, 0
        if self.changed:
            self._send()
        self._film.moisture.copy_to_device(self.film.moisture)
        if self._tables is None or self._tables[0] is not curves:
            self._tables = curves, cuda.to_device(curves), cuda.to_device(gravity)
        if self._log is None or self._log.shape[1] < steps:
            self._log = cuda.to_device(np.zeros((kernels.LOG_ROWS, max(steps, curves.shape[1]))))
        self._ledger.copy_to_device(ledger)
        outcome = np.array([kernels.DONE, 0])
        self._outcome.copy_to_device(outcome)
        self._launch(column, steps, tuple(map(float, scheme)))
        self._outcome.copy_to_host(outcome)
        self._ledger.copy_to_host(ledger)
        log[:] = self._log.copy_to_host()[:, :steps]
        self._fetch()
        return int(outcome[REASON]), int(outcome[STEPS_DONE])

    def _launch(self, column: int, steps: int, scheme: tuple[float, ...]) -> None:
        arrays = self._elements, self._nodes, self._loads, self._film, self._plan, *self._tables[1:]
        results = self._ledger, self._log, self._outcome
        self._kernel[self.blocks, THREADS](*arrays, column, steps, scheme, *results)

    def _changing(self):
        """(processor's array, card's array, order of the card's rows or None) of all that steps change."""
        yield self.nodes.u, self._nodes.u, None
        yield self.nodes.du, self._nodes.du, None
        if self.elements.history.size:
            yield self.elements.history, self._elements.history, None
        if len(self.loads.moved_dof):
            yield self.loads.reaction, self._loads.reaction, None
        if len(self.loads.face_pa):
            yield self.loads.face_force, self._loads.face_force, None
        if len(self.film.area):
            yield self.film.memory, self._film.memory, None
            yield self.film.pair_memory, self._film.pair_memory, self._pairs

    def _send(self) -> None:
        for here, there, order in self._changing():
            there.copy_to_device(here if order is None else np.ascontiguousarray(here[order]))
        self._nodes.seen.copy_to_device(self.nodes.seen)
        self._nodes.compliance.copy_to_device(self.nodes.compliance)
        self.changed = False

    def _fetch(self) -> None:
        for here, there, order in self._changing():
            if order is None:
                there.copy_to_host(here)
            else:
                here[order] = there.copy_to_host()
        self.nodes.seen[:] = self.nodes.u


def workers(blocks: int) -> int:
    """How many of the blocks have elements and nodes of their own."""
    return max(blocks - 1, 1)


def _plan(elements, nodes, loads, film, count, blocks, heavy) -> tuple[Plan, np.ndarray, dict[str, np.ndarray]]:
    """The plan of a run, where the card's pairs are among the processor's, and the fields of Film that say so."""
    chain_of, pairs, chains = _chains(film, count)
    free = np.flatnonzero(chain_of < 0)
    held = np.flatnonzero(chain_of >= 0)
    held = held[np.argsort(chain_of[held], kind="stable")]
    order = np.concatenate([held, free]).astype(np.uint32)  # unsigned: as in assembly.load_arrays
    # A chain or a node alone goes to the block in whose share it begins.
    begins = np.concatenate([np.flatnonzero(np.diff(chain_of[held], prepend=-1)), np.arange(len(held), count)])
    share = -(-count // workers(blocks))
    first_of = np.searchsorted(begins // share, np.arange(blocks + 1))
    node_starts = np.append(begins, count)[np.minimum(first_of, len(begins))]
    chain_starts = np.minimum(first_of, len(chains["pair_starts"]) - 1)

    on_nodes = [
        np.asarray(elements.numbers) // 4,
        np.stack([film.lower, film.upper], axis=2).astype(np.int64).ravel(),
        np.full(1, -1),
        *loads.face_nodes.T,
    ]
    corners, struts, faces = elements.numbers.size, film.lower.size * 2 + 1, len(loads.face_pa) + 1
    of_faces = corners + struts + np.arange(len(loads.face_pa))
    places = np.concatenate([np.arange(corners + struts), *[of_faces] * loads.face_nodes.shape[1]])
    on_nodes = np.concatenate(on_nodes)
    real = (on_nodes >= 0) & (on_nodes < count)
    on_nodes, places = on_nodes[real], places[real]
    by_node = np.argsort(on_nodes, kind="stable")
    on_nodes, places = on_nodes[by_node], places[by_node]
    starts = np.searchsorted(on_nodes, np.arange(count + 1))
    used = -(-np.diff(starts) // ROUND) * ROUND
    nothing = corners + struts + faces
    table = np.full((used.max(), count), nothing, np.uint32)
    table[np.arange(len(places)) - starts[on_nodes], on_nodes] = places
    loaded = np.zeros(count, np.int32)
    loaded[(np.concatenate([loads.force_dof, loads.moved_dof]) // 4).astype(np.int64)] = 1
    real_type = elements.constants.dtype
    plan = Plan(
        forces=np.zeros((3, nothing + 1), real_type),
        of_struts=np.zeros((3, struts), real_type),
        of_faces=np.zeros((3, faces), real_type),
        order=order,
        node_starts=node_starts,
        places=np.ascontiguousarray(table[:, order]),
        used=used[order].astype(np.int32),
        loaded=loaded[order],
        chain_starts=chain_starts,
        sums=np.zeros((SUMS, blocks)),
        heavy=int(heavy),
    )
    return plan, pairs, chains


def _chains(film, count: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Pairs that share nodes follow one another, as one thread eases them in the processor's order.

    Returns
    -------
    chain_of : (count,) number of the chain of each node, -1 where it has no strut
    pairs : (D,) the pairs of the film, chain after chain
    fields : what Film has of pairs, in this order, `pair_starts` (chains + 1,) by chain
    """
    low, up = film.pair_lower.astype(np.int64), film.pair_upper.astype(np.int64)
    links = sparse.coo_array((np.ones(len(low)), (low, up)), shape=(count, count))
    label = connected_components(links, directed=False)[1]
    of_pair = np.unique(label[low], return_inverse=True)[1].ravel()
    chain_of = np.full(count, -1)
    chain_of[low], chain_of[up] = of_pair, of_pair
    pairs = np.argsort(of_pair, kind="stable")
    first = film.pair_first.astype(np.int64)
    struts = [film.pair_struts[first[d] : first[d + 1]] for d in pairs]
    fields = {
        "pair_lower": film.pair_lower[pairs],
        "pair_upper": film.pair_upper[pairs],
        "pair_struts": np.concatenate([film.pair_struts[:0], *struts]),
        "pair_first": np.append(0, np.cumsum([len(one) for one in struts])).astype(np.uintp),
        "pair_upper_part": film.pair_upper_part[pairs],
        "pair_tissue": film.pair_tissue[pairs],
        "pair_memory": film.pair_memory[pairs],
        "pair_starts": np.searchsorted(of_pair[pairs], np.arange(of_pair.max(initial=-1) + 2)),
    }
    return chain_of, pairs, fields
