import dataclasses
import hashlib
import json

import av
import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator import clip as clips
from simulator import render
from simulator.clip import make_clip, unfinished
from simulator.errors import InputError, Interrupted
from simulator.export import load_motion
from simulator.inside import jaw_matrix
from simulator.motion import ENERGIES, Stop
from simulator.scene import Action, Camera, Face, Output, Scene, load_scene

SCENE = Scene(
    name="yawn",
    about="A mouth opens",
    face=Face(resolution="low"),
    muscle=(Action("jaw", keys=((0.0, 0.0), "smooth", (1.0, 1.0))),),
    output=Output(frame_rate=10),
    camera=Camera(width_px=96, height_px=64),
)
TRUTH = [
    "yawn.energy.csv",
    "yawn.frames.csv",
    "yawn.json",
    "yawn.metres.frames.csv",
    "yawn.metres.openings.csv",
    "yawn.openings.csv",
    "yawn.polygons.json",
    "yawn.saliva.csv.gz",
]
ALWAYS = sorted([*TRUTH, "yawn.clip.json", "yawn.h5", "yawn.scene.toml"])


@pytest.fixture
def moved(monkeypatch):
    """The solver replaced by a mouth moved by formula; returns how it was called."""
    calls = []

    def simulate(scene, **how):
        calls.append(how)
        motion = moved_mouth("low", len(scene.state_times_s))[1]
        times = scene.state_times_s
        return dataclasses.replace(
            motion, time_s=times, energies={name: np.zeros(len(times)) for name in ENERGIES}, settings={"safety": 0.9}
        )

    monkeypatch.setattr(clips, "simulate", simulate)
    return calls


def replace_simulate(monkeypatch, change):
    before = clips.simulate
    monkeypatch.setattr(clips, "simulate", lambda scene, **how: change(before(scene, **how)))


def names(folder):
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir() if path.is_file()}


def pictures(path):
    """(T, H, W, 3) RGB of a video."""
    with av.open(str(path)) as container:
        return np.array([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_truth_alone_makes_no_pictures(moved, tmp_path):
    clip = make_clip(SCENE, tmp_path / "out", truth_only=True)
    assert names(tmp_path / "out") == ALWAYS == sorted(path.name for path in clip.files)
    assert clip.motion.stopped is None and set(clip.seconds) == {"solve", "truth"}
    motion = load_motion(tmp_path / "out" / "yawn.h5")
    assert np.array_equal(motion.positions, clip.motion.positions)
    assert np.array_equal(motion.saliva.state, clip.motion.saliva.state)
    rows = (tmp_path / "out" / "yawn.frames.csv").read_text().splitlines()
    assert len(rows) == 1 + 11


def test_the_written_scene_makes_the_same_clip_again(moved, tmp_path):
    make_clip(SCENE, tmp_path / "a", truth_only=True)
    scene = load_scene(tmp_path / "a" / "yawn.scene.toml")
    assert scene == SCENE.spelled_out()
    make_clip(scene, tmp_path / "b", truth_only=True)
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


def test_provenance(moved, tmp_path):
    make_clip(SCENE, tmp_path, stem="yawn_7", truth_only=True)
    told = json.loads((tmp_path / "yawn_7.clip.json").read_text())
    text = (tmp_path / "yawn_7.scene.toml").read_bytes()
    assert told["sha256"] == {"yawn_7.scene.toml": hashlib.sha256(text).hexdigest()}
    assert told["scene"] == "yawn_7" and load_scene(tmp_path / "yawn_7.scene.toml").name == "yawn_7"
    assert told["elements"] == 870 and told["states"] == 11 and told["solver"] == {"safety": 0.9}
    assert set(told["files"]) == set(names(tmp_path)) - {"yawn_7.clip.json"}


def test_pictures_and_page(moved, tmp_path):
    scene = dataclasses.replace(SCENE, camera=Camera(width_px=97, height_px=65))
    make_clip(scene, tmp_path)
    assert set(names(tmp_path)) - set(ALWAYS) == {"yawn.mkv", "yawn.mp4", "yawn.view.html"}
    exact, people = pictures(tmp_path / "yawn.mkv"), pictures(tmp_path / "yawn.mp4")
    assert exact.shape == (11, 65, 97, 3) and people.shape == (11, 64, 96, 3)
    drawn = list(
        render(
            make_clip(scene, tmp_path / "b", truth_only=True).motion,
            moved_mouth("low")[0],
            scene.camera,
            scene.look,
            times_s=scene.frame_times_s,
            frame_rate=10,
            jaw=lambda t: None,
        )
    )
    assert np.array_equal(exact[0], drawn[0])  # lossless; later the jaw has turned
    assert np.abs(people[-1].astype(float) - exact[-1, :64, :96]).mean() < 6
    again = tmp_path / "again"
    make_clip(scene, again)
    assert digests(again) == digests(tmp_path)


def test_no_video_for_people_where_it_is_not_wanted(moved, tmp_path):
    make_clip(SCENE, tmp_path, people=False)
    assert "yawn.mkv" in names(tmp_path) and "yawn.mp4" not in names(tmp_path)


def test_the_lower_teeth_follow_the_jaw():
    mouth = SCENE.face.mouth()
    jaw, points = SCENE.jaw(mouth), mouth.nodes[::50]
    for time in (0.0, 0.3, 1.0):
        matrix = jaw_matrix(clips._lower_teeth(SCENE, mouth)(time))
        np.testing.assert_allclose(points @ matrix[:3, :3].T + matrix[:3, 3], jaw.turned(points, time), atol=1e-12)
    assert jaw.turned(points, 1.0)[:, 1].mean() < points[:, 1].mean() - 0.01


def test_two_readers_of_one_stream():
    got = {}

    def keep(name):
        return lambda frames: got.update({name: list(frames)})

    clips._read_twice(iter(range(50)), keep("first"), keep("second"))
    assert got == {"first": list(range(50)), "second": list(range(50))}

    def give_up(frames):
        next(frames)
        raise InputError("no room")

    for first, second in ((keep("first"), give_up), (give_up, keep("second")), (give_up, give_up)):
        with pytest.raises(InputError, match="no room"):
            clips._read_twice(iter(range(50)), first, second)


def test_exports(moved, tmp_path):
    make_clip(SCENE, tmp_path, truth_only=True, exports=clips.EXPORTS)
    assert set(names(tmp_path)) - set(ALWAYS) == {
        "yawn.glb",
        "yawn.mtl",
        "yawn.obj",
        "yawn.pc2",
        "yawn.pvd",
        "yawn_obj",
        "yawn_vtu",
    }
    assert len(list((tmp_path / "yawn_vtu").iterdir())) == 11
    assert len(list((tmp_path / "yawn_obj").glob("*.obj"))) == 11
    make_clip(SCENE, tmp_path, truth_only=True, exports=["obj"])  # over what is there
    assert len(list((tmp_path / "yawn_obj").glob("*.obj"))) == 11
    with pytest.raises(InputError, match="expected exports of obj, pc2, gltf or vtu, got 'gtlf'; did you mean 'gltf'"):
        make_clip(SCENE, tmp_path, exports=["gtlf"])


def test_surfaces_come_along(moved, tmp_path, monkeypatch):
    (tmp_path / "ball.obj").write_text("v 0 0 0\n")
    action = Action("zygomaticus", keys=((0.0, 1.0),), volume_obj=str(tmp_path / "ball.obj"))
    scene = dataclasses.replace(SCENE, muscle=(*SCENE.muscle, action))
    monkeypatch.setattr(Scene, "spelled_out", lambda self: self)
    files = clips.clip_sources(scene, "yawn")
    assert files["yawn.muscle2.obj"] == b"v 0 0 0\n"
    assert 'volume_obj = "yawn.muscle2.obj"' in files["yawn.scene.toml"].decode()


# -- runs that fail ---------------------------------------------------------------------------------------------------


@pytest.fixture
def earlier(moved, tmp_path):
    """A folder with a whole clip, and its digests."""
    make_clip(SCENE, tmp_path / "out", truth_only=True)
    return tmp_path / "out", digests(tmp_path / "out")


def kept(folder, before):
    """The files beside those of the clip that was there, which must be as they were."""
    now = digests(folder)
    assert {name: now[name] for name in before} == before
    return sorted(set(now) - set(before))


def test_a_run_that_blows_up_keeps_its_states_and_the_clip_before(earlier, monkeypatch):
    folder, before = earlier
    stop = Stop(0.3, 7, "an element turned inside out", "take a smaller step")

    def cut(motion):
        few = {name: values[:4] for name, values in motion.energies.items()}
        return dataclasses.replace(
            motion, time_s=motion.time_s[:4], positions=motion.positions[:4], energies=few, saliva=None, stopped=stop
        )

    replace_simulate(monkeypatch, cut)
    clip = make_clip(SCENE, folder, truth_only=True)
    assert clip.motion.stopped == stop
    assert kept(folder, before) == ["yawn.unfinished.energy.csv", "yawn.unfinished.h5"]
    assert clip.files[0] == unfinished(folder, "yawn")
    assert load_motion(clip.files[0]).stopped == stop and len(load_motion(clip.files[0]).time_s) == 4


def test_an_interrupted_run_keeps_its_states(earlier, monkeypatch):
    folder, before = earlier

    def interrupt(motion):
        raise Interrupted(dataclasses.replace(motion, stopped=Stop(0.5, None, "interrupted", "go on")), 2)

    replace_simulate(monkeypatch, interrupt)
    with pytest.raises(Interrupted):
        make_clip(SCENE, folder, truth_only=True)
    assert kept(folder, before) == ["yawn.unfinished.energy.csv", "yawn.unfinished.h5"]


def test_pictures_that_fail_leave_the_motion_and_the_clip_before(earlier, monkeypatch):
    folder, before = earlier

    def fail(*args):
        (args[3] / "yawn.mkv").write_bytes(b"half")
        raise InputError("expected room on the disk, got none")

    monkeypatch.setattr(clips, "_write_videos", fail)
    with pytest.raises(InputError, match=r"got none; the motion is kept in .*yawn\.unfinished\.h5"):
        make_clip(SCENE, folder)
    assert kept(folder, before) == ["yawn.unfinished.energy.csv", "yawn.unfinished.h5"]
    assert len(load_motion(unfinished(folder, "yawn")).time_s) == 11
    make_clip(SCENE, folder, truth_only=True)  # a run that succeeds takes what was kept away
    assert kept(folder, before) == []


def test_a_stop_by_hand_while_drawing_leaves_nothing_half(earlier, monkeypatch):
    folder, before = earlier

    def stop(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(clips, "_write_videos", stop)
    with pytest.raises(KeyboardInterrupt):
        make_clip(SCENE, folder)
    assert kept(folder, before) == ["yawn.unfinished.energy.csv", "yawn.unfinished.h5"]


def test_a_scene_that_cannot_be_modelled_touches_nothing(earlier):
    folder, before = earlier
    with pytest.raises(InputError, match="expected width_m between"):
        make_clip(dataclasses.replace(SCENE, face=Face(width_m=1.0)), folder)
    assert kept(folder, before) == []


def test_a_place_that_cannot_be_written(moved, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected an output folder to write to, got"):
        make_clip(SCENE, tmp_path / "file" / "out", truth_only=True)
    assert moved == []


def test_a_scene_says_in_which_mode_it_is_drawn():
    mouth, motion = moved_mouth("low", 3)
    drawn = {}
    for mode in ("picture", "wireframe", "stress"):
        scene = Scene(name="x", duration_s=1.0, camera=Camera(64, 64), output=Output(mode=mode))
        drawn[mode] = next(iter(clips.pictures(scene, mouth, motion, np.array([1.0]))))
    assert not np.array_equal(drawn["picture"], drawn["wireframe"])
    assert not np.array_equal(drawn["stress"], drawn["wireframe"])
