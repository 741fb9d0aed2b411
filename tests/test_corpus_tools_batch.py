"""`corpus run`: every clip once, whatever comes between, and the same store in the end."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import mouth_clip
import pytest
from clips import moving_pictures, write_pictures, write_video

from corpus_tools import batch
from corpus_tools.clips import Clip
from corpus_tools.store import Store
from corpus_tools.workers import Outcome
from lipmetrics import measure, pipeline
from lipmetrics.cli import main
from lipmetrics.console import sentence
from lipmetrics.errors import InputError


def corpus(folder, count=4):
    """Videos that differ, of few small pictures."""
    folder.mkdir(exist_ok=True)
    paths = [folder / f"p01_m_{k}.mp4" for k in range(1, count + 1)]
    return [Clip(write_video(path, moving_pictures(3, seed=k)), path.stem, {"n": k}) for k, path in enumerate(paths)]


class Work:
    """Does the jobs here, in the order of their keys turned round, and may stop after some."""

    def __init__(self):
        self.done, self.stop_after = [], None

    def __call__(self, function, jobs, processes_n):
        assert function == "corpus_tools.batch:measure_clip"
        for key, arguments in sorted(jobs, reverse=True):
            if self.stop_after is not None and len(self.done) >= self.stop_after:
                raise KeyboardInterrupt
            try:
                yield Outcome(key, batch.measure_clip(*arguments))
            except Exception as error:
                yield Outcome(key, error=sentence(error))
            self.done.append(key)


@pytest.fixture
def work(monkeypatch):
    """Clips are measured in this process, and a drawn profile is what is found in each."""
    worker = Work()
    worker.measured = []

    def drawn(path, **how):
        facts = pipeline.source_facts(path)
        if facts["bytes"] < 100:
            raise InputError(f"cannot read {path}")
        worker.measured.append((Path(path).name, how["method"]))
        made = mouth_clip.profile_of(mouth_clip.looks_of(["closed", "open"]), [0, 0.5 + facts["bytes"] / 1e6])
        made.meta |= {"source": facts}
        return made

    monkeypatch.setattr(batch, "work", worker)
    monkeypatch.setattr(pipeline, "measure", drawn)
    return worker


def test_what_is_unchanged_is_not_measured_again(tmp_path, work):
    clips, store = corpus(tmp_path / "clips"), tmp_path / "s.h5"
    answer = batch.run(clips, store)
    assert answer["text"] == [f"4 of 4 clips in {store}, 4 measured now"] and answer["failed"] == []
    assert (answer["done_n"], answer["measured_n"], answer["unchanged_n"]) == (4, 4, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["clips", "s.h5"] or not (tmp_path / "s.h5.parts").exists()
    first, inode = store.read_bytes(), store.stat().st_ino
    work.measured.clear(), work.done.clear()
    assert batch.run(clips, store)["measured_n"] == 0
    assert work.done == [] and store.stat().st_ino == inode  # not even written again

    os.utime(clips[1].path, (1, 1))  # looks changed, has the same content
    assert batch.run(clips, store)["unchanged_n"] == 4
    assert work.done == ["p01_m_2"] and work.measured == []
    work.done.clear()
    assert batch.run(clips, store)["measured_n"] == 0 and work.done == []

    clips[2].path.write_bytes(clips[0].path.read_bytes())
    assert batch.run(clips, store)["measured_n"] == 1 and work.measured == [("p01_m_3.mp4", "default")]
    assert store.read_bytes() != first
    work.measured.clear()
    assert batch.run(clips, store, method="thesis")["measured_n"] == 4
    assert set(work.measured) == {(clip.path.name, "thesis") for clip in clips}


def test_contents_are_compared_where_asked(tmp_path, work):
    clips, store = corpus(tmp_path / "clips", 2), tmp_path / "s.h5"
    batch.run(clips, store)
    path, at = clips[0].path, clips[0].path.stat()
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    os.utime(path, ns=(at.st_atime_ns, at.st_mtime_ns))
    assert batch.run(clips, store)["measured_n"] == 0  # the same size and time: believed
    assert batch.run(clips, store, reread=True)["measured_n"] == 1


def test_a_part_of_a_video_is_a_clip_of_its_own(tmp_path, work):
    (clip,) = corpus(tmp_path / "clips", 1)
    store = tmp_path / "s.h5"
    parts = [Clip(clip.path, f"word-{k}", start_s=k / 25, stop_s=(k + 1) / 25) for k in range(2)]
    assert batch.run(parts, store)["measured_n"] == 2
    moved = [parts[0], Clip(clip.path, "word-1", start_s=1 / 25, stop_s=3 / 25)]
    assert batch.run(moved, store)["measured_n"] == 1


def test_more_clips_join_and_fields_change(tmp_path, work):
    clips, store = corpus(tmp_path / "clips"), tmp_path / "s.h5"
    batch.run(clips[:2], store)
    renamed = Clip(clips[2].path, clips[2].name, {"n": 2, "level": 7})
    assert batch.run([renamed], store)["text"] == [f"1 of 1 clips in {store}, 1 measured now"]
    with Store(store) as found:
        assert found.names == [clip.name for clip in clips[:3]]
    inode = store.stat().st_ino
    assert batch.run(clips, store)["measured_n"] == 1 and store.stat().st_ino != inode
    with Store(store) as found:
        assert found.fields("p01_m_3") == {"n": 2} and len(found.names) == 4
    batch.run(clips, tmp_path / "once.h5")
    assert store.read_bytes() == (tmp_path / "once.h5").read_bytes()


@pytest.mark.parametrize("after", range(4))
def test_a_run_that_was_stopped_goes_on(tmp_path, work, after):
    clips, store, whole = corpus(tmp_path / "clips"), tmp_path / "s.h5", tmp_path / "whole.h5"
    batch.run(clips, whole)
    work.measured.clear(), work.done.clear()
    work.stop_after = after
    with pytest.raises(KeyboardInterrupt):
        batch.run(clips, store)
    kept = list((tmp_path / "s.h5.parts").iterdir()) if after else []
    assert not store.exists() and len(kept) == after
    work.stop_after = None
    if kept:  # what a power failure and a killed run leave behind
        (kept[0].parent / "broken.h5").write_bytes(kept[0].read_bytes()[:2000])
        (kept[0].parent / ".x.h5.1.part").write_bytes(b"")
        (kept[0].parent / "merged.h5").write_bytes(whole.read_bytes()[:5000])
    batch.run(clips, store)
    assert len(work.measured) == len(clips) and store.read_bytes() == whole.read_bytes()
    assert not (tmp_path / "s.h5.parts").exists()


def test_a_broken_clip_is_passed_over_and_told(tmp_path, work, capsys):
    clips = corpus(tmp_path / "clips")
    (tmp_path / "clips/p01_m_2.mp4").write_bytes(b"nothing")
    store = tmp_path / "s.h5"
    words = ["corpus", "run", str(tmp_path / "clips"), "-o", str(store)]
    for k in range(2):  # told again, not tried again
        assert main([*words, "--json"]) == 3
        said = capsys.readouterr()
        path = tmp_path / "clips/p01_m_2.mp4"
        assert said.err == f"lipmetrics: {path}: cannot read {path}\n"
        answer = json.loads(said.out)
        assert answer["done_n"] == 3 and answer["measured_n"] == (0 if k else 3)
    assert len(work.done) == 4
    with Store(store) as found:
        assert found.names == ["p01_m_1", "p01_m_3", "p01_m_4"] and list(found.failed) == ["p01_m_2"]
    (tmp_path / "clips/p01_m_2.mp4").write_bytes(clips[0].path.read_bytes())
    assert main(words) == 0
    assert capsys.readouterr().out == f"4 of 4 clips in {store}, 1 measured now\n"


def test_what_may_go_well_next_time_is_tried_again(tmp_path, work, monkeypatch):
    clips, store = corpus(tmp_path / "clips", 2), tmp_path / "s.h5"
    drawn = pipeline.measure

    def sick(path, **how):
        if Path(path).stem == "p01_m_1":
            raise MemoryError
        return drawn(path, **how)

    monkeypatch.setattr(pipeline, "measure", sick)
    assert batch.run(clips, store)["failed"][0]["error"].startswith("ran out of memory")
    monkeypatch.setattr(pipeline, "measure", drawn)
    assert batch.run(clips, store)["failed"] == [] and len(work.done) == 3

    def slow(path, **how):
        made = drawn(path, **how)
        os.utime(path, (1, 1))
        return made

    monkeypatch.setattr(pipeline, "measure", slow)
    answer = batch.run(clips, tmp_path / "t.h5")
    assert "p01_m_1.mp4 changed while it was measured; run it again" in answer["failed"][0]["error"]


def test_other_versions_on_a_worker_are_refused(tmp_path, work, monkeypatch):
    clips = corpus(tmp_path / "clips", 1)
    job = (clips[0], "default", "f" * 64, None)
    monkeypatch.setattr(batch, "work", lambda *_: (Outcome("p01_m_1", batch.measure_clip(*job)) for _ in range(1)))
    with pytest.raises(InputError, match="expected the same versions of lipmetrics, Python and its packages here and"):
        batch.run(clips, tmp_path / "s.h5")
    assert not (tmp_path / "s.h5").exists()


def test_bad_input(tmp_path, work):
    clips, store = corpus(tmp_path / "clips", 2), tmp_path / "s.h5"
    with pytest.raises(InputError, match="expected one clip or more to measure, got none"):
        batch.run([], store)
    with pytest.raises(InputError, match=r"expected clips of different names, got p01_m_1 for .* and .*p01_m_2.mp4"):
        batch.run([clips[0], Clip(clips[1].path, "p01_m_1")], store)
    with pytest.raises(
        InputError, match="expected a method out of default, thesis, got 'theses'; did you mean 'thesis'"
    ):
        batch.run(clips, store, method="theses")
    with pytest.raises(InputError, match="that can stand in a store"):
        batch.run([Clip(clips[0].path, ".")], store)
    store.write_bytes(b"a poem")
    with pytest.raises(InputError, match="no HDF5 file or is damaged"):
        batch.run(clips, store)
    assert store.read_bytes() == b"a poem" and not (tmp_path / "s.h5.parts").exists()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"expected to write .*choose another place for the store"):
        batch.run(clips, tmp_path / "file" / "s.h5")


def test_one_run_at_a_time(tmp_path, work):
    clips, store = corpus(tmp_path / "clips", 1), tmp_path / "s.h5"
    with (
        batch._parts_folder(store),
        pytest.raises(InputError, match="written by one run at a time, another is at work"),
    ):
        batch.run(clips, store)
    assert batch.run(clips, store)["done_n"] == 1


# -- in processes of their own -----------------------------------------------------------------------------------------


def real_corpus(folder, count, frames_n=12):
    """Mouths that are seen: opening ellipses; one folder of pictures, one broken clip."""
    folder.mkdir()
    for k in range(count):
        outlines = [mouth_clip.ellipse(2 + k % 5 + i / 2) for i in range(frames_n)]
        write_video(folder / f"p01_m_{k + 1}.mp4", [mouth_clip.picture([one]) for one in outlines])
    write_pictures(folder / "p01_os_1", [mouth_clip.picture([mouth_clip.ellipse(5)])] * 3)
    (folder / "p01_broken_1.mp4").write_bytes(b"\0" * 300)


def start(folder, store, *more):
    words = [sys.executable, "-m", "lipmetrics.cli", "corpus", "run", str(folder), "-o", str(store), "--fps", "25"]
    return subprocess.Popen([*words, "--jobs", "2", *more], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(run):
    out, err = run.communicate(timeout=900)
    assert run.returncode == 3, err
    assert err.count("\n") == 1 and "p01_broken_1.mp4: cannot read" in err
    return out


def parts_of(store):
    """Whole files of finished clips, with what tells whether one was made anew."""
    try:
        paths = [path for path in Path(f"{store}.parts").iterdir() if not path.name.startswith(".")]
        return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in paths if path.name != "merged.h5"}
    except OSError:
        return {}


def workers_of(pid):
    """Processes that measure for this one."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    except OSError:
        return []


def kill_at_random(folder, store, rng, longest_s, kills_n, of_worker):
    """Run until it is done, with so many kills at random moments; gives how many kills there were."""
    killed = 0
    while True:
        before = parts_of(store)
        run, begin = start(folder, store), time.monotonic()
        at_s = rng.uniform(0, longest_s)
        while run.poll() is None and killed < kills_n:
            if of_worker:
                victims = workers_of(run.pid)
                if time.monotonic() - begin > at_s and victims:
                    os.kill(rng.choice(victims), signal.SIGKILL)
                    killed, at_s = killed + 1, at_s + rng.uniform(0.5, longest_s)
            elif time.monotonic() - begin > at_s:
                run.kill()
                run.communicate()
                killed += 1
                break
            time.sleep(0.005)
        now = parts_of(store)
        assert not now or before.items() <= now.items()  # nothing that was finished is done again
        if run.poll() != -signal.SIGKILL:
            finish(run)
            return killed


@pytest.mark.slow
def test_real_processes(tmp_path):
    """One kill of the run and one of a worker; the store says what `measure` says."""
    folder, whole, store = tmp_path / "clips", tmp_path / "whole.h5", tmp_path / "s.h5"
    real_corpus(folder, 4, 6)
    wanted = measure(folder / "p01_m_2.mp4")  # compiles, so that what follows takes the time of the work alone
    begin = time.monotonic()
    assert finish(start(folder, whole)) == f"5 of 6 clips in {whole}, 5 measured now\n"
    longest_s = time.monotonic() - begin
    with Store(whole) as found:
        got = found.profile("p01_m_2")
        assert got.frames.equals(wanted.frames) and got.openings.equals(wanted.openings)
        assert json.loads(json.dumps(got.meta)) == json.loads(json.dumps(wanted.meta))
        assert (wanted.frames["status"] == "open").any() and len(found.takes({"utterance": "m"})) == 4
    run = start(folder, store)
    time.sleep(0.7 * longest_s)
    run.kill()
    run.communicate()
    assert kill_at_random(folder, store, random.Random(1), longest_s, 1, of_worker=True) <= 1
    assert store.read_bytes() == whole.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("of_worker", [False, True])
def test_kills_at_random_moments(tmp_path, of_worker):
    """4 of them; `LIPMETRICS_KILLS=20` takes some minutes."""
    kills = int(os.environ.get("LIPMETRICS_KILLS", "4"))
    folder, whole = tmp_path / "clips", tmp_path / "whole.h5"
    real_corpus(folder, 12, 20)
    begin = time.monotonic()
    finish(start(folder, whole))
    longest_s, rng, killed, k = time.monotonic() - begin, random.Random(1), 0, 0
    while killed < kills:
        store, k = tmp_path / f"{k}.h5", k + 1
        killed += kill_at_random(folder, store, rng, longest_s, kills - killed, of_worker)
        assert store.read_bytes() == whole.read_bytes()


@pytest.mark.slow
def test_on_a_dask_cluster(tmp_path):
    distributed = pytest.importorskip("distributed")
    folder, store = tmp_path / "clips", tmp_path / "s.h5"
    real_corpus(folder, 3)
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    )
    with cluster:
        out = finish(start(folder, store, "--dask", cluster.scheduler_address))
    assert out == f"4 of 5 clips in {store}, 4 measured now\n"
    finish(start(folder, tmp_path / "here.h5"))
    assert store.read_bytes() == (tmp_path / "here.h5").read_bytes()
