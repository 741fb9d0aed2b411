"""Ground truth of a mouth moved by formula, against the formula and against the measurement's own tables."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from moved_mouth import moved_mouth

import lipmetrics
from lipmetrics.look import Look
from lipmetrics.openings import Identities, measure_outline
from lipmetrics.outline import fill_outlines
from lipmetrics.profile import RATE_FORMULA, frame_row, opening_row, rate_of_change, tables
from simulator import tables as own_tables
from simulator.aperture import COAT_M
from simulator.camera import Camera
from simulator.errors import InputError
from simulator.motion import INTACT, STICKING, SalivaRecord
from simulator.playback import at_times
from simulator.truth import truth

TURNED = Camera(yaw_deg=20, pitch_deg=-8, roll_deg=25)
PATCH = (0.004, 0.009)


@pytest.fixture(scope="module")
def parted():
    """A mouth with two openings that merge at half of the time."""
    return moved_mouth("low", 21, patch=PATCH)


@pytest.fixture(scope="module")
def parted_truth(parted):
    mouth, motion = parted
    return truth(motion, mouth)


def measured(found):
    """Both tables, from the polygons alone, by the code that measures videos."""
    frame_rows, opening_rows, identities = [], [], Identities()
    for k, (time_s, polygons) in enumerate(zip(found.frames["time_s"], found.polygons, strict=True)):
        look = Look("open" if polygons else "closed", polygons, confidence=1.0)
        openings = [measure_outline(polygon) for polygon in polygons]
        who = identities.update(openings)
        frame_rows.append(frame_row(k, time_s, look, openings))
        opening_rows += [opening_row(k, time_s, w, o) for w, o in zip(who, openings, strict=True)]
    return tables(frame_rows, opening_rows, found.meta["mouth_width_px"])


@pytest.mark.parametrize("camera", [Camera(), TURNED, Camera(roll_deg=-90)], ids=["straight", "turned", "on its side"])
def test_tables_are_those_of_the_measurement_of_the_same_polygons(parted, camera):
    mouth, motion = parted
    found = truth(motion, mouth, camera)
    frames, openings = measured(found)
    assert len(openings) > 15
    pd.testing.assert_frame_equal(found.frames, frames, rtol=1e-9, atol=1e-9)
    pd.testing.assert_frame_equal(found.openings, openings, rtol=1e-9, atol=1e-9)


def test_two_openings_then_a_merge_with_a_jump_in_width(parted_truth):
    frames, openings = parted_truth.frames, parted_truth.openings
    assert frames["n_openings"].max() == 2
    merge = openings[openings["event"] == "merge"]
    assert (merge["time_s"].tolist(), merge["parents"].tolist()) == ([0.5], ["1+2"])
    at = int(merge["frame"].iloc[0])
    assert frames["width_mw"][at] > frames["width_mw"][at - 1] + 0.1
    assert (frames["total_area_px"] >= frames["area_px"]).all()


def test_area_and_width_in_metres_are_those_of_the_formula():
    """Straight on both edges coincide: the area is the trapezium rule over the columns, 0 where saliva is intact."""
    mouth, motion = moved_mouth("low", 6)
    found = truth(motion, mouth)
    x = mouth.nodes[mouth.upper[:, 0], 0]
    for k, state in enumerate(motion.saliva.state):
        upper, lower = motion.positions[k][mouth.upper[:, 0]], motion.positions[k][mouth.lower[:, 0]]
        rest = np.linalg.norm(mouth.nodes[mouth.upper[:, 0]] - mouth.nodes[mouth.lower[:, 0]], axis=1)
        apart = upper - lower
        distance = np.linalg.norm(apart, axis=1)
        gap = np.minimum(apart[:, 1] * (1 - (rest + COAT_M) / distance), apart[:, 1])
        gap[distance < rest + COAT_M] = 0
        open_elements = np.flatnonzero(state != INTACT)
        tied = np.ones(len(x), bool)
        if len(open_elements):
            tied[open_elements[0] + 1 : open_elements[-1] + 1] = False
            tied[0] = state[0] == INTACT
            tied[-1] = state[-1] == INTACT
        gap[tied] = 0
        row = found.frames_m.iloc[k]
        assert row["area_m2"] == pytest.approx(np.trapezoid(gap, x), rel=1e-9, abs=1e-15)
        assert row["height_m"] == pytest.approx(gap.max(), rel=1e-9, abs=1e-12)
        inner = np.flatnonzero(gap > 0)
        width = x[min(inner[-1] + 1, len(x) - 1)] - x[max(inner[0] - 1, 0)] if len(inner) else 0.0
        assert row["width_m"] == pytest.approx(width, abs=1e-12)
    assert found.meta["mouth_width_m"] == pytest.approx(mouth.width_m, rel=1e-6)


def test_metres_and_pixels_agree_far_from_the_camera(parted):
    mouth, motion = parted
    camera = Camera(distance_m=100.0, yaw_deg=10)
    found = truth(motion, mouth, camera)
    scale = camera.px_per_m
    np.testing.assert_allclose(found.frames["width_px"], found.frames_m["width_m"] * scale, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found.frames["area_mw2"], found.frames_m["area_mw2"], rtol=2e-3, atol=1e-6)
    middle = np.array([(camera.height_px - 1) / 2, (camera.width_px - 1) / 2])
    rows = found.openings_m["centroid_row_m"] + camera.centre_y_m
    np.testing.assert_allclose(found.openings["centroid_row"], middle[0] + rows * scale, atol=0.1)


def test_a_tilted_head_has_the_same_openings_turned(parted):
    mouth, motion = parted
    centred = Camera(centre_y_m=0)  # or the head would turn about another point than the picture's middle
    straight, tilted = truth(motion, mouth, centred), truth(motion, mouth, dataclasses.replace(centred, roll_deg=40))
    np.testing.assert_allclose(tilted.frames["area_px"], straight.frames["area_px"], rtol=1e-9)
    assert tilted.meta["mouth_width_px"] == pytest.approx(straight.meta["mouth_width_px"])
    np.testing.assert_array_equal(tilted.openings["opening"], straight.openings["opening"])
    turn = np.radians(40)
    middle = np.array(straight.shape) / 2 - 0.5
    row, column = (straight.polygons[-1][0] - middle).T
    there = np.stack([row * np.cos(turn) + column * np.sin(turn), column * np.cos(turn) - row * np.sin(turn)], axis=1)
    apart = np.linalg.norm(there[:, None] + middle - tilted.polygons[-1][0][None], axis=-1)
    assert apart.min(axis=1).max() < 1e-6


def test_a_symmetric_mouth_opens_symmetrically_to_rounding():
    mouth, motion = moved_mouth("low", 6)
    openings = truth(motion, mouth).openings_m
    np.testing.assert_allclose(openings["col_min_m"], -openings["col_max_m"], atol=1e-15)
    np.testing.assert_allclose(openings["centroid_col_m"], 0, atol=1e-15)


def test_a_mouth_that_never_opens_is_closed_and_0_throughout(parted, tmp_path):
    mouth, motion = parted
    record = motion.saliva
    glued = dataclasses.replace(record, state=np.zeros_like(record.state))
    found = truth(dataclasses.replace(motion, saliva=glued), mouth)
    assert set(found.frames["status"]) == {"closed"}
    assert not found.frames[["n_openings", "width_px", "area_mw2", "total_area_px"]].to_numpy(float).any()
    assert len(found.openings) == 0 and not found.masks().any()
    found.save(tmp_path, "glued")
    read = lipmetrics.load_profile(tmp_path / "glued")
    pd.testing.assert_frame_equal(read.openings, found.openings)


def test_at_rest_broken_saliva_is_closed_too(parted):
    mouth, motion = parted
    record = dataclasses.replace(motion.saliva, state=np.full_like(motion.saliva.state, STICKING))
    found = truth(dataclasses.replace(motion, positions=np.repeat(motion.nodes[None], 21, 0), saliva=record), mouth)
    assert set(found.frames["status"]) == {"closed"}


@pytest.mark.parametrize("times", [None, []])
def test_no_frames(parted, tmp_path, times):
    mouth, motion = parted
    if times is None:
        motion = at_times(motion, [])
    found = truth(motion, mouth, times=times)
    assert len(found.frames) == len(found.openings) == len(found.saliva) == 0
    assert found.masks().shape == (0, 512, 512)
    found.save(tmp_path, "none")
    pd.testing.assert_frame_equal(lipmetrics.load_profile(tmp_path / "none").frames, found.frames)


def test_other_times_are_those_of_the_motion_at_these_times(parted):
    mouth, motion = parted
    times = np.array([0.13, 0.501, 0.99])
    found, expected = truth(motion, mouth, times=times), truth(at_times(motion, times), mouth)
    pd.testing.assert_frame_equal(found.openings, expected.openings)
    np.testing.assert_array_equal(found.frames["time_s"], times)


def test_masks_hold_the_pixels_inside_the_polygons(parted):
    mouth, motion = parted
    found = truth(motion, mouth, TURNED)
    masks = found.masks()
    assert masks.shape == (21, 512, 512) and masks.any()
    for k in (5, 9, 20):
        np.testing.assert_array_equal(masks[k], fill_outlines(found.polygons[k], found.shape))
    np.testing.assert_allclose(masks.sum(axis=(1, 2)), found.frames["total_area_px"], atol=40)


def test_saliva_and_energies_are_those_of_the_motion(parted, parted_truth):
    mouth, motion = parted
    saliva = parted_truth.saliva
    assert list(saliva.columns) == ["frame", "time_s", "element", "x_m", "state", "stretch", "moisture", "critical"]
    assert len(saliva) == 21 * len(mouth.saliva)
    last = saliva[saliva["frame"] == 20]
    np.testing.assert_array_equal(last["element"], mouth.saliva)
    np.testing.assert_array_equal(last["stretch"], motion.saliva.stretch[20])
    assert (last["x_m"].diff().dropna() > 0).all()
    np.testing.assert_array_equal(saliva["state"] == "broken", (motion.saliva.state == 1).ravel())
    energies = truth(dataclasses.replace(motion, energies={"kinetic_j": np.arange(21.0)}), mouth).energies
    assert energies.columns.tolist() == ["frame", "time_s", "kinetic_j"]


def test_the_order_of_the_record_does_not_matter(parted, parted_truth):
    mouth, motion = parted
    back = slice(None, None, -1)
    r = motion.saliva
    turned = SalivaRecord(r.elements[back], *(a[:, back] for a in (r.state, r.stretch, r.moisture, r.critical)))
    found = truth(dataclasses.replace(motion, saliva=turned), mouth)
    pd.testing.assert_frame_equal(found.openings, parted_truth.openings)
    pd.testing.assert_frame_equal(found.saliva, parted_truth.saliva)


def test_files_read_back_and_have_the_same_bytes(parted, parted_truth, tmp_path):
    paths = parted_truth.save(tmp_path / "a", "clip")
    mouth, motion = parted
    truth(motion, mouth).save(tmp_path / "b", "clip")
    names = sorted(path.name for path in paths)
    endings = (
        "energy.csv frames.csv json metres.frames.csv metres.openings.csv openings.csv polygons.json saliva.csv.gz"
    )
    assert names == sorted(f"clip.{ending}" for ending in endings.split())
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == names
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name

    read = lipmetrics.load_profile(tmp_path / "a" / "clip")
    pd.testing.assert_frame_equal(read.frames, parted_truth.frames, rtol=1e-6, atol=1e-6)
    pd.testing.assert_frame_equal(read.openings, parted_truth.openings, rtol=1e-6, atol=1e-6)
    assert read.meta["mouth_width_found"] == "geometry" and read.meta["file"] == "clip"
    assert read.meta["mouth_width_px"] == parted_truth.meta["mouth_width_px"]
    read.save(tmp_path / "c", "clip")
    for ending in ("frames.csv", "openings.csv"):
        here, there = (tmp_path / folder / f"clip.{ending}" for folder in "ac")
        assert here.read_bytes() == there.read_bytes()

    zipped = tmp_path / "a" / "clip.saliva.csv.gz"
    assert zipped.read_bytes()[4:8] == bytes(4)  # no time of day
    saliva = pd.read_csv(zipped)
    np.testing.assert_allclose(saliva["stretch"], parted_truth.saliva["stretch"], rtol=1e-6)
    metres = pd.read_csv(tmp_path / "a" / "clip.metres.frames.csv")
    np.testing.assert_allclose(metres["area_m2"], parted_truth.frames_m["area_m2"], rtol=1e-6)


def test_polygons_read_back(parted_truth, tmp_path):
    parted_truth.save(tmp_path, "clip")
    read = json.loads((tmp_path / "clip.polygons.json").read_text())
    assert (read["format"], read["unit"], read["shape"]) == ("lipmetrics polygons 1", "px", [512, 512])
    assert len(read["frames"]) == 21
    for frame, polygons in zip(read["frames"], parted_truth.polygons, strict=True):
        for opening, polygon in zip(frame["openings"], polygons, strict=True):
            np.testing.assert_allclose(opening["outline"], polygon, atol=6e-6)
    numbers = [opening["opening"] for frame in read["frames"] for opening in frame["openings"]]
    assert numbers == parted_truth.openings["opening"].tolist()


def test_provenance_is_plain_json_whatever_the_solver_noted(parted, tmp_path):
    mouth, motion = parted
    odd = {"dt": np.float64(1e-4), "licks": (np.arange(3),), "level": float("nan"), "of": Camera}
    truth(dataclasses.replace(motion, settings=odd), mouth).save(tmp_path, "odd")
    solver = json.loads((tmp_path / "odd.json").read_text())["settings"]["solver"]
    assert (solver["dt"], solver["licks"], solver["level"]) == (1e-4, [[0, 1, 2]], None)


def test_rates_are_those_of_the_measurement():
    assert own_tables.RATE_FORMULA == RATE_FORMULA
    rng = np.random.default_rng(2)
    values, time_s = rng.normal(size=12), np.cumsum(rng.uniform(0.01, 0.1, 12))
    np.testing.assert_allclose(own_tables.rate_of_change(values, time_s), rate_of_change(values, time_s))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: dataclasses.replace(m, saliva=None), "expected a motion with the saliva's states, got one without"),
        (lambda m: dataclasses.replace(m, positions=m.positions[:, :-1]), "got 1887; give the mouth that was solved"),
        (
            lambda m: dataclasses.replace(m, saliva=dataclasses.replace(m.saliva, elements=m.saliva.elements + 1)),
            "elements of the mouth's saliva, got one of .*, other ones among them",
        ),
        (
            lambda m: dataclasses.replace(
                m, positions=np.where(m.time_s > 0.9, np.nan, 1)[:, None, None] * m.positions
            ),
            "expected lips at finite places, got NaN or infinity at 0.95 s",
        ),
    ],
    ids=["no saliva", "other mesh", "other elements", "blown up"],
)
def test_motions_that_cannot_be_seen(parted, change, message):
    mouth, motion = parted
    changed = change(motion)
    with pytest.raises(InputError, match=message):
        truth(changed, mouth)


def test_times_outside_the_motion(parted):
    mouth, motion = parted
    with pytest.raises(InputError, match="expected times from 0 to 1 s"):
        truth(motion, mouth, times=[0.5, 1.5])


def test_a_place_that_cannot_be_written_to(parted_truth, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected to write"):
        parted_truth.save(tmp_path / "file", "clip")
