"""Pictures of a moving mouth: skin, lips and what is between them, drawn as a camera would see them.

The opening is not sampled but covered: every pixel's exact share of the region between the lips' edges is mixed in,
so that its border is right to a small part of a pixel. Everything depends on the arguments and the seed of the look
alone, so any frame can be drawn by itself.
"""

from __future__ import annotations

import math
import queue
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import cv2
import numpy as np

from simulator import raster, shade
from simulator.aperture import SEEN_M, LipEdges, lip_edges, shown_positions, visible
from simulator.camera import Camera
from simulator.errors import InputError
from simulator.inside import colours_of, jaw_matrix, rows_of, teeth_table, tongue_of
from simulator.look import Look, to_linear, to_srgb
from simulator.motion import BROKEN, INTACT, Motion
from simulator.mouth import LIPS, SALIVA, Mouth
from simulator.playback import states_at, values_at
from simulator.stress import von_mises
from simulator.texture import skin_texture
from simulator.wording import choices, nearest

MODES = ("picture", "wireframe", "stress")
THREADS = 2
# Rings of skin around the sheet, so that the picture has no rim: how far out they stand and how much they move along.
_RINGS = ((1.12, 0.9), (1.3, 0.6), (1.6, 0.25), (2.2, 0.0), (4.0, 0.0))
_GRAIN = 2**16  # random numbers of which the noise is made: half a second-level cache
_CURVE = to_srgb(np.linspace(0, 1, 16384)).round().astype(np.uint8)
_TURBO = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]


def render(
    motion: Motion,
    mouth: Mouth,
    camera: Camera | None = None,
    look: Look | None = None,
    *,
    times_s: np.ndarray | None = None,
    frame_rate: float | Fraction = 30,
    mode: str = "picture",
    scalars: np.ndarray | None = None,
    jaw: Callable[[float], object] | None = None,
    threads: int = THREADS,
) -> Iterator[np.ndarray]:
    """Frames of a motion, in order, drawn on `threads` threads.

    Positions between saved times are interpolated linearly. The shutter is open around the time of its frame.

    Parameters
    ----------
    times_s : (F,) times of the frames, s, within those of the motion; None takes frame_rate from the first time on
    frame_rate : frames per second; also the clock of the shutter
    mode : one of `MODES`
    scalars : for "stress", (T, E) or (T, N) at the motion's times, shown on a scale from 0 to their largest value; None
        takes the von Mises stress of the tissue
    jaw : from a time, s, to the jaw's (4, 4) movement from rest, or (angle_deg, (y_m, z_m) of its joint)

    Yields
    ------
    (H, W, 3) uint8 RGB

    Raises
    ------
    InputError : times outside of the motion, an unknown mode, shapes that do not fit
    """
    camera, look = camera or Camera(), look or Look()
    _check(mode, mouth, motion.positions, scalars, len(motion.time_s))
    if not (0 < float(frame_rate) < 1e6):
        raise InputError(f"expected frame_rate above 0 frames per second, got {frame_rate}")
    first, last = float(motion.time_s[0]), float(motion.time_s[-1])
    if times_s is None:
        times_s = first + np.arange(int((last - first) * float(frame_rate) + 1e-6) + 1) / float(frame_rate)
    times_s = np.asarray(times_s, float)
    if times_s.ndim != 1 or not (np.isfinite(times_s).all()):
        raise InputError(f"expected times_s as a list of times, got shape {times_s.shape}")
    slack = 1e-9 * max(1.0, abs(last))
    if len(times_s) and (times_s.min() < first - slack or times_s.max() > last + slack):
        raise InputError(
            f"expected frames from {first:g} to {last:g} s, the times of the motion, got "
            f"{times_s.min():g} to {times_s.max():g} s"
        )
    return _frames(motion, mouth, camera, look, times_s, float(frame_rate), mode, scalars, jaw, threads)


def _frames(motion, mouth, camera, look, times_s, frame_rate, mode, scalars, jaw, threads):
    stage = Stage(mouth, camera, look, mode)
    top = None
    if mode == "stress":
        if scalars is None:
            scalars = np.nan_to_num(von_mises(mouth, motion.positions))
        tissue = mouth.group != SALIVA
        top = float(np.max(scalars[:, tissue] if scalars.shape[1] == len(tissue) else scalars)) or 1.0
    half = look.sensor.shutter / frame_rate / 2
    states = None if motion.saliva is None else motion.saliva.of(mouth.saliva).state

    def draw(number: int) -> np.ndarray:
        time = times_s[number]
        during = None
        if half > 0 and mode == "picture":
            during = (
                _at(motion.time_s, motion.positions, time - half),
                _at(motion.time_s, motion.positions, time + half),
            )
        state = None
        if states is not None:
            state = states_at(motion.time_s, states, [_within(motion.time_s, time)])[0]
        return stage.draw(
            _at(motion.time_s, motion.positions, time),
            state=state,
            during=during,
            jaw=None if jaw is None else jaw(float(time)),
            frame=number,
            scalars=None if scalars is None else _at(motion.time_s, scalars, time),
            top=top,
        )

    frames = _in_order(draw, len(times_s), threads)
    if look.sensor.h264 is not None and mode == "picture":
        from simulator.video import compressed

        frames = compressed(frames, frame_rate=Fraction(frame_rate).limit_denominator(1001), crf=look.sensor.h264)
    yield from frames


def _in_order(draw: Callable[[int], np.ndarray], count: int, threads: int) -> Iterator[np.ndarray]:
    if threads <= 1:
        yield from map(draw, range(count))
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting = deque()
        try:
            for number in range(count):
                waiting.append(pool.submit(draw, number))
                if len(waiting) > 2 * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for one in waiting:
                one.cancel()


def draw_mouth(
    mouth: Mouth,
    positions: np.ndarray,
    camera: Camera | None = None,
    look: Look | None = None,
    *,
    mode="picture",
    **how,
) -> np.ndarray:
    """One picture of a mouth, (H, W, 3) uint8 RGB; for many of them use `render` or a `Stage`.

    Parameters
    ----------
    positions : (N, 3) of the mouth's nodes, m
    mode : one of `MODES`
    how : see `Stage.draw`

    Raises
    ------
    InputError : an unknown mode, or shapes that do not fit
    """
    _check(mode, mouth, positions, None, 1)
    return Stage(mouth, camera or Camera(), look or Look(), mode).draw(positions, **how)


class Stage:
    """A mouth before a camera in a light: what all its pictures share, made once.

    Parameters
    ----------
    mouth : mesh
    camera : place and size of the picture
    look : skin, light, inside of the mouth and sensor
    mode : one of `MODES`
    """

    def __init__(self, mouth: Mouth, camera: Camera, look: Look, mode: str = "picture"):
        self.mouth, self.camera, self.look, self.mode = mouth, camera, look, mode
        self.rest_lips = self._lips(mouth.nodes)
        # from row and column to places along and across the mouth, as the truth has it, and back
        corners = camera.project(self.rest_lips[:, [0, -1], 0].mean(axis=0))
        row, column = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
        self.along = np.array([[row, column], [column, -row]])
        self._canvases: queue.SimpleQueue = queue.SimpleQueue()
        self._build()
        if mode == "picture":
            texture = skin_texture(mouth, look, 1 / camera.px_per_m)
            self.texture = texture.values
            places = texture.places(*self.flat.T)
        else:
            places = np.zeros((2, len(self.rest)))
        self.attributes = np.zeros((len(self.rest), 8), np.float32)
        self.attributes[:, shade.TEX_X], self.attributes[:, shade.TEX_Y] = places
        self.wet = np.zeros(len(self.rest), np.float32)
        self.wet[self.inner_edges] = 1
        self._light()
        sensor = look.sensor
        self.gains = (sensor.exposure * np.array([*sensor.cast, 0.0])).astype(np.float32)
        at = np.arange(-math.ceil(3 * sensor.blur_px), math.ceil(3 * sensor.blur_px) + 1)
        lens = np.exp(-0.5 * (at / (sensor.blur_px or 1.0)) ** 2)
        self.lens = (lens / lens.sum()).astype(np.float32)
        self.grain = np.random.default_rng(4).standard_normal(_GRAIN + 4 * camera.width_px, np.float32)
        inside = look.inside
        self.teeth = teeth_table(False, look.seed), teeth_table(True, look.seed)
        self.rows, self.tongue, self.colours = rows_of(inside), tongue_of(inside), colours_of(inside)
        self.shown = np.array([inside.upper_teeth, inside.lower_teeth, inside.tongue], float)
        fade = np.linspace(1.12, 0.8, camera.height_px)[:, None]
        self.backdrop = (fade * to_linear(look.background)).astype(np.float32)
        film = (self.light[2] * 0.6 + self.light[3]) * look.skin.lip_linear * 0.9 + 0.04 * self.light[2]
        self.film_colour = film.astype(np.float32)

    def _build(self) -> None:
        """Vertices and triangles of skin, lips, the lips' inner faces and rings of skin around the sheet."""
        mouth = self.mouth
        outer = np.unique(mouth.outer)
        self.nodes = np.concatenate([outer, mouth.upper[:, 1], mouth.lower[:, 1]])
        number = np.full(len(mouth.nodes), -1)
        number[outer] = np.arange(len(outer))
        columns = len(mouth.upper)
        inner_upper = len(outer) + np.arange(columns)
        inner_lower = inner_upper + columns
        self.inner_edges = np.concatenate([inner_upper, inner_lower])
        self.upper, self.lower = number[mouth.upper[:, 0]], number[mouth.lower[:, 0]]
        skin = number[mouth.outer[mouth.group != SALIVA]]
        upper, lower = self.upper, self.lower
        under = np.stack([upper[:-1], inner_upper[:-1], inner_upper[1:], upper[1:]], axis=1)
        over = np.stack([lower[:-1], lower[1:], inner_lower[1:], inner_lower[:-1]], axis=1)
        rest = mouth.nodes[self.nodes]
        rim = number[_rim(mouth.outer)]  # in order around the sheet
        middle = rest[:, :2].mean(axis=0) * [0, 1]
        rings, flat, move, quads = [], [], [], []
        before = rim
        for stretch, along in _RINGS:
            ring = np.empty((len(rim), 3))
            ring[:, :2] = middle + (rest[rim, :2] - middle) * stretch
            flat.append(ring[:, :2].copy())
            ring[:] = _head(ring[:, :2], rest[rim])
            now = len(self.nodes) + sum(map(len, rings)) + np.arange(len(rim))
            quads.append(np.stack([before, now, np.roll(now, -1), np.roll(before, -1)], axis=1))
            rings.append(ring)
            move.append(np.full(len(rim), along))
            before = now
        self.rim = np.tile(rim, len(_RINGS))
        self.ring_move = np.concatenate(move)[:, None]
        self.ring_rest = np.concatenate(rings) - self.ring_move * rest[self.rim]
        self.rest = np.concatenate([rest, *rings])
        self.flat = np.concatenate([rest[:, :2], *flat])  # where the vertices lie in the texture
        quads = np.concatenate([skin, under, over, *quads])
        # diagonals mirror each other on both sides of the face
        left = self.rest[quads][:, :, 0].mean(axis=1) < 0
        quads[left] = np.roll(quads[left], 1, axis=1)
        self.triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)
        weight = np.ones(len(quads))
        weight[len(skin) : len(skin) + 2 * len(under)] = 0.35  # so the lips' edges are rounded, not cut
        self.quads, self.weight = quads.astype(np.uint32), weight
        # triangles of skin alone: away from the red (the border is soft and wanders), the lips' edges and inner faces
        border = np.concatenate([mouth.border_m[self.nodes], np.full(len(self.rest) - len(self.nodes), -1.0)])
        border[np.concatenate([self.upper, self.lower, self.inner_edges])] = 1.0
        # a coarse quad may hold red though its corners lie outside
        width = np.ptp(self.rest[self.triangles, 0], axis=1)
        self.plain = border[self.triangles].max(axis=1) < -0.003 - width

    def _light(self) -> None:
        light, skin = self.look.light, self.look.skin
        towards = np.asarray(light.direction, float)
        towards = towards / np.linalg.norm(towards)
        half = towards + np.array([0, 0, 1])
        half = half / max(np.linalg.norm(half), 1e-9)
        # light goes through skin and comes out again farther on, red the farthest
        wrap = 0.10 + 0.8 * light.softness * np.array([0.55, 0.38, 0.33]) + np.array([0.12, 0.02, 0.0])
        self.light = np.stack(
            [
                towards,
                half,
                light.strength * to_linear(light.colour),
                light.ambient * to_linear(light.ambient_colour),
                wrap,
                skin.lip_linear * [0.20, 0.12, 0.12],
            ]
        ).astype(np.float32)
        self.finish = np.array([skin.sheen, skin.wetness, skin.gloss, skin.seam], np.float32)
        turn = self.camera.rotation
        self.axes = np.ascontiguousarray(turn.T[:2]).astype(np.float32)
        self.inner_light = np.concatenate([self.light[:2] @ turn, self.light[2:4]]).astype(float)
        camera = self.camera
        self.view = np.zeros((3, 6))
        self.view[:, :3] = turn.T
        self.view[:, 3] = turn.T @ [camera.centre_x_m, camera.centre_y_m, 0.0]
        self.view[0, 4], self.view[1, 4] = camera.px_per_m, camera.distance_m
        self.view[0, 5], self.view[1, 5] = (camera.height_px - 1) / 2, (camera.width_px - 1) / 2

    def draw(
        self,
        positions: np.ndarray,
        *,
        state: np.ndarray | None = None,
        during: tuple[np.ndarray, np.ndarray] | None = None,
        jaw=None,
        frame: int = 0,
        scalars: np.ndarray | None = None,
        top: float | None = None,
    ) -> np.ndarray:
        """One picture, (H, W, 3) uint8 RGB.

        Parameters
        ----------
        positions : (N, 3) of the mouth's nodes, m
        state : (S,) of the saliva elements, see simulator.motion; None: all broken
        during : positions when the shutter opens and when it closes, for motion blur
        jaw : movement of the jaw from rest, see `simulator.inside.jaw_matrix`
        frame : number of the frame, of which the noise depends
        scalars : (E,) or (N,), shown in mode "stress" from 0 to `top`
        """
        state = self._state(state)
        canvas = self._canvas()
        shown, *ends = shown_positions(self.mouth, np.array([positions, *(during or ())]))
        if self.mode == "wireframe":
            return self._wireframe(shown, state)
        if self.mode == "stress":
            if scalars is None:
                scalars = np.nan_to_num(von_mises(self.mouth, np.asarray(positions)[None])[0])
            values = np.asarray(scalars, float)
            linear = self._stressed(canvas, positions, shown, state, values, top)
            picture = to_srgb(linear).round().astype(np.uint8)
        else:
            linear = self._linear(canvas, positions, shown, state, during, ends, jaw_matrix(jaw))
            picture = self._developed(linear, frame)
        self._canvases.put(canvas)
        return picture

    def cover(self, positions: np.ndarray, state: np.ndarray | None = None) -> np.ndarray:
        """(H, W) float32, the exact share of every pixel through which one sees into the mouth; no effects, no blur."""
        state = self._state(state)
        canvas = self._canvas()
        self._cover(canvas, self._lips(positions)[:, None], state, clear=0.0)
        hole = canvas["hole"].copy()
        self._canvases.put(canvas)
        return hole

    # ---- parts of a picture

    def _canvas(self) -> dict:
        try:
            return self._canvases.get_nowait()
        except queue.Empty:
            pass
        height, width = self.camera.height_px, self.camera.width_px
        size = (height, width)
        return {
            "nearest": np.empty(size, np.float32),
            "owner": np.empty(size, np.float32),
            "bary": np.zeros((2, *size), np.float32),
            "tissue": np.zeros((*size, 4), np.float32),
            "moved": np.zeros((*size, 2), np.float32),
            "far": np.empty(size, np.int32),
            "cover": np.zeros((2, height, width + 2)),
            "hole": np.zeros(size, np.float32),
            "film": np.zeros(size, np.float32),
            "inside": np.zeros((*size, 3), np.float32),
            "linear": np.empty((*size, 4), np.float32),
            "normals": np.empty((len(self.rest), 3)),
            "attributes": self.attributes.copy(),
        }

    def _vertices(self, shown: np.ndarray) -> np.ndarray:
        """(V, 3) places of all vertices, m."""
        at = shown[self.nodes]
        return np.concatenate([at, self.ring_rest + self.ring_move * at[self.rim]])

    def _project(self, seen: np.ndarray) -> np.ndarray:
        """(..., 2) row and column of points in the camera's axes; as Camera.project."""
        camera = self.camera
        scale = camera.px_per_m * camera.distance_m / (camera.distance_m - seen[..., 2])
        row = (camera.height_px - 1) / 2 - seen[..., 1] * scale
        return np.stack([row, (camera.width_px - 1) / 2 + seen[..., 0] * scale], axis=-1)

    def _raster(self, canvas: dict, shown: np.ndarray) -> np.ndarray:
        """Fill owner, bary and normals; return the vertices' places (V, 2), px."""
        seen = self.camera.seen(self._vertices(shown))
        places = self._project(seen)
        raster.vertex_normals(seen, self.quads, self.weight, canvas["normals"])
        raster.draw_triangles(places, seen[:, 2], self.triangles, canvas["nearest"], canvas["owner"], canvas["bary"])
        return places

    def _state(self, state: np.ndarray | None) -> np.ndarray:
        state = np.full(len(self.mouth.saliva), BROKEN) if state is None else np.asarray(state)
        if state.shape != self.mouth.saliva.shape:
            raise InputError(
                f"expected one state for each of {len(self.mouth.saliva)} saliva elements, got {state.shape}"
            )
        return state

    def _lips(self, positions: np.ndarray) -> np.ndarray:
        """(2, S + 1, 2, 3) of the upper and the lower lip's edges, m, with the film between them."""
        return np.stack([np.asarray(positions)[nodes] for nodes in (self.mouth.upper, self.mouth.lower)])

    def _edges(self, lips: np.ndarray, state: np.ndarray | None) -> LipEdges:
        """Lips' edges (2, M, S + 1, 2, 3) as they are seen, see `lip_edges`."""
        states = None if state is None else np.broadcast_to(state, (lips.shape[1], len(state)))
        return lip_edges(*lips, *self.rest_lips, states)

    def _cover(self, canvas: dict, lips: np.ndarray, state: np.ndarray, clear: float) -> tuple[int, int, int, int]:
        """Fill hole and film: the mean over places of the lips' edges (2, M, S + 1, 2, 3); return a box around them.

        The hole is what the truth calls open. Between it and the lips hangs saliva that is stretched, through which
        one sees a share `clear`.
        """
        height, width = canvas["hole"].shape
        cover, hole, film = canvas["cover"], canvas["hole"], canvas["film"]
        old = canvas.get("box", (0, 0, 0, 0))
        hole[old[0] : old[1]] = 0
        film[old[0] : old[1]] = 0
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        glued = bool((state == INTACT).any())
        for layer, states in ((0, state), (1, None)):
            if layer == 1 and not glued:
                continue
            edges = self._edges(lips, states)
            turned = self.camera.project(np.stack([edges.upper, edges.lower])) @ self.along
            pieces = visible(turned[0], turned[1], edges.loose, SEEN_M * self.camera.px_per_m)
            points = pieces.points @ self.along
            if len(points):
                low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
                # the corners run clockwise
                raster.add_polygons(points, pieces.start, -1 / lips.shape[1], cover[layer])
        if not (low < high).all():
            low = high = np.full(2, -10.0)
        rows = max(int(low[0]) - 1, 0), min(int(high[0]) + 3, height)
        columns = max(int(low[1]) - 1, 0), min(int(high[1]) + 3, width)
        box = (*rows, *columns) if rows[0] < rows[1] and columns[0] < columns[1] else (0, 0, 0, 0)
        canvas["box"] = box
        raster.sum_cover(cover[0], box[:2], hole)
        if glued:
            raster.sum_cover(cover[1], box[:2], film)
            part = np.s_[box[0] : box[1], box[2] : box[3]]
            between = np.maximum(film[part] - hole[part], 0)
            hole[part] += clear * between
            film[part] = (1 - clear) * between
        return box

    def _clear(self, state: np.ndarray, gap_m: np.ndarray) -> float:
        """Share of the light that goes through stretched saliva: more where it is drawn out."""
        held = state == INTACT
        drawn_m = float(((gap_m[:-1] + gap_m[1:]) / 2)[held].mean()) if held.any() else 0.0
        return 1 - self.look.skin.film * math.exp(-max(drawn_m - 0.0015, 0.0) / 0.003)

    def _linear(self, canvas, positions, shown, state, during, ends, jaw) -> np.ndarray:
        mouth, sensor = self.mouth, self.look.sensor
        places = self._raster(canvas, shown)
        velocity, samples = np.zeros_like(places), 1
        lips = self._lips(positions)[:, None]
        if during is not None:
            begin, end = (self._project(self.camera.seen(self._vertices(one))) for one in ends)
            velocity = end - begin
            farthest = float(np.abs(velocity).max())
            if farthest > 0.3:
                samples = min(int(farthest) + 2, sensor.samples)
                # the lips' edges take little work, so they have more places
                share = (np.arange(2 * samples)[:, None, None, None] + 0.5) / (2 * samples)
                begin, end = (self._lips(p)[:, None] for p in during)
                lips = begin + share * (end - begin)
        gap = np.linalg.norm(shown[mouth.upper[:, 0]] - shown[mouth.lower[:, 0]], axis=1)
        box = self._cover(canvas, lips, state, self._clear(state, gap))
        attributes = canvas["attributes"]
        attributes[:, shade.NX : shade.NZ + 1] = canvas["normals"]
        attributes[:, shade.MOVED_ROW : shade.MOVED_COLUMN + 1] = velocity
        closed = np.exp(-gap / 0.0008)
        for vertices in (self.upper, self.lower, *np.split(self.inner_edges, 2)):
            attributes[vertices, shade.CLOSED] = closed
        tissue, moved = canvas["tissue"], canvas["moved"]
        shade.shade_tissue(
            canvas["owner"],
            canvas["bary"],
            self.triangles,
            self.plain,
            attributes,
            self.wet,
            self.texture,
            self.axes,
            self.light,
            self.finish,
            self.backdrop,
            tissue,
            moved,
        )
        inside = self.look.inside
        if box[1] > box[0]:
            shade.fill_between(canvas["owner"], canvas["hole"], canvas["film"], box, tissue, moved, canvas["far"])
            shade.shade_inside(
                canvas["hole"],
                box,
                self.view,
                np.ascontiguousarray(np.linalg.inv(jaw)[:3]),
                self.shown,
                self.rows,
                *self.teeth,
                self.colours,
                self.inner_light,
                self.tongue,
                np.array([inside.shadow, inside.depth_m, 1.0]),
                1 / self.camera.px_per_m,
                self.look.seed,
                canvas["inside"],
            )
        linear = tissue
        if samples > 1:
            linear = canvas["linear"]
            shade.smear(tissue, moved, samples, linear)
        shade.compose(linear, canvas["inside"], canvas["hole"], canvas["film"], self.film_colour, box)
        return linear

    def _developed(self, linear: np.ndarray, frame: int) -> np.ndarray:
        sensor = self.look.sensor
        picture = np.empty((*linear.shape[:2], 3), np.uint8)
        own = self.look.sensor.seed
        seed = (
            ((self.look.seed if own is None else own) * 1_000_003 + frame * 7919 + 17) * self.camera.height_px % 2**63
        )
        effects = map(float, (sensor.noise, sensor.read_noise, sensor.vignette))
        shade.develop(linear, self.lens, self.gains, *effects, self.grain, seed, _CURVE, picture)
        if sensor.jpeg is not None:
            _, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, sensor.jpeg])
            picture = np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])
        return picture

    def _stressed(self, canvas, positions, shown, state, values, top) -> np.ndarray:
        """Linear light of a mouth whose surface shows numbers as colours."""
        mouth = self.mouth
        if values.shape == (len(mouth.elements),):
            tissue = mouth.group != SALIVA
            at = mouth.elements[tissue].ravel()
            count = np.bincount(at, minlength=len(mouth.nodes))
            sums = np.bincount(at, np.repeat(values[tissue], 8), minlength=len(mouth.nodes))
            values = sums / np.maximum(count, 1)
        elif values.shape != (len(mouth.nodes),):
            raise InputError(
                f"expected scalars for {len(mouth.elements)} elements or {len(mouth.nodes)} nodes, got {values.shape}"
            )
        self._raster(canvas, shown)
        on = values[self.nodes] / (top or float(np.max(np.abs(values))) or 1.0)
        on = np.concatenate([on, on[self.rim]])
        gap = np.linalg.norm(shown[mouth.upper[:, 0]] - shown[mouth.lower[:, 0]], axis=1)
        box = self._cover(canvas, self._lips(positions)[:, None], state, self._clear(state, gap))
        tissue, owner = canvas["tissue"], canvas["owner"]
        tissue[..., :3] = self.backdrop[:, None]
        t = self.triangles[np.maximum(owner, 0).astype(int)]
        u, v = canvas["bary"].astype(float)
        weights = np.stack([1 - u - v, u, v], axis=-1)
        level = np.clip(255 * (on[t] * weights).sum(axis=-1), 0, 255)
        facing = np.clip((canvas["normals"][t, 2] * weights).sum(axis=-1), 0, 1)
        colour = to_linear(_TURBO)[np.where(owner >= 0, level, 0).astype(int)] * (0.35 + 0.65 * facing)[..., None]
        tissue[owner >= 0, :3] = colour[owner >= 0]
        canvas["moved"][:] = 0
        canvas["inside"][:] = to_linear((25, 20, 22))
        if box[1] > box[0]:
            shade.fill_between(owner, canvas["hole"], canvas["film"], box, tissue, canvas["moved"], canvas["far"])
        film = to_linear((200, 215, 235)).astype(np.float32)
        shade.compose(tissue, canvas["inside"], canvas["hole"], canvas["film"], film, box)
        return tissue[..., :3]

    def _wireframe(self, shown: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The mesh's outer edges on black: skin grey, lips red, intact saliva blue."""
        mouth, camera = self.mouth, self.camera
        picture = np.full((camera.height_px, camera.width_px, 3), 18, np.uint8)
        places = np.rint(camera.project(shown)[:, ::-1] * 16).astype(np.int32)
        for group, colour in ((None, (150, 150, 150)), (LIPS, (235, 110, 105)), (SALIVA, (95, 165, 255))):
            quads = mouth.outer[mouth.group != SALIVA if group is None else mouth.group == group]
            if group == SALIVA:
                quads = mouth.outer[mouth.saliva[state != BROKEN]]
            cv2.polylines(picture, list(places[quads]), True, colour, 1, cv2.LINE_AA, 4)
        return picture


def _head(flat: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(n, 3) of the head around the sheet, m, where its skin laid flat reaches to x, y (n, 2) out from rim (n, 3).

    It turns away at the sides within a centimetre and goes on as throat behind the chin.
    """
    x, y = flat.T
    side, low, high = np.abs(rim[:, 0]).max(), rim[:, 1].min(), rim[:, 1].max()
    out = np.maximum(np.abs(x) - side, 0)
    head = np.stack(
        [np.sign(x) * (np.minimum(np.abs(x), side) + 0.010 * (1 - np.exp(-out / 0.010))), y, rim[:, 2]], axis=1
    )
    head[:, 2] -= (np.minimum(np.abs(x), side) ** 2 - rim[:, 0] ** 2) / 0.150 + 1.3 * out
    head[:, 2] += 0.12 * np.clip(y - high, 0, 0.03)
    head[:, 2] -= 1.25 * np.clip(low - y, 0, 0.03) + 0.1 * np.maximum(low - 0.03 - y, 0)
    return head


def _rim(quads: np.ndarray) -> np.ndarray:
    """Nodes around a sheet of quads (Q, 4), in order, counter-clockwise as its faces are."""
    a, b = np.stack([quads, np.roll(quads, -1, axis=1)]).reshape(2, -1).astype(np.int64)
    many = quads.max() + 1
    alone = ~np.isin(a * many + b, b * many + a)  # edges that no other quad runs along the other way
    following = dict(zip(a[alone].tolist(), b[alone].tolist(), strict=True))
    if not following:
        raise InputError("expected a sheet with a rim, got a closed surface")
    loops = []
    while following:
        start, at = next(iter(following.items()))
        loop = [start]
        del following[start]
        while at != start and at in following:
            loop.append(at)
            at = following.pop(at)
        loops.append(loop)
    return np.array(max(loops, key=len))


def _within(time_s: np.ndarray, time: float) -> float:
    """The saved time nearest to a time beyond all of them, else the time itself."""
    return float(np.clip(time, time_s[0], time_s[-1]))


def _at(time_s: np.ndarray, values: np.ndarray, time: float) -> np.ndarray:
    """Values (T, ...) at a time, linear between the saved ones, constant outside."""
    return values_at(time_s, values, [_within(time_s, time)])[0]


def _check(mode: str, mouth: Mouth, positions: np.ndarray, scalars, times: int) -> None:
    if mode not in MODES:
        raise InputError(f"expected a mode of {choices(MODES)}, got {nearest(mode, MODES)}")
    shape = np.shape(positions)
    if shape[-2:] != (len(mouth.nodes), 3):
        raise InputError(f"expected positions of this mouth's {len(mouth.nodes)} nodes, (..., N, 3), got shape {shape}")
    if not np.isfinite(positions).all():
        raise InputError("expected finite positions, got NaN or infinite ones; draw the times before the run failed")
    if scalars is not None and (
        np.ndim(scalars) != 2
        or np.shape(scalars)[0] != times
        or np.shape(scalars)[1] not in (len(mouth.nodes), len(mouth.elements))
    ):
        raise InputError(
            f"expected scalars at {times} times for {len(mouth.elements)} elements or {len(mouth.nodes)} nodes, "
            f"got shape {np.shape(scalars)}"
        )
