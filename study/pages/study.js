// The trials: two videos that start together, replay at will, one answer each, sent until the server has it.
"use strict";

const texts = JSON.parse(document.getElementById("texts").textContent);
const $ = (id) => document.getElementById(id);
const SIDES = ["left", "right"];
const LIMITS = { wait_ms: 8000, first_retry_ms: 500, longest_retry_ms: 8000, apart_s: 0.1 };

let trial = null; // what the server said of this trial
let videos = {}; // by side
let look = null; // what was measured of this trial
let shelf = {}; // videos of the next trial, loading, by address
let sending = false;

// -- what the server says -------------------------------------------------------------------------------------------

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Ask until there is a reply: the server may be starting anew, the phone may be in a tunnel.
async function ask(address, options) {
  for (let wait = LIMITS.first_retry_ms; ; wait = Math.min(2 * wait, LIMITS.longest_retry_ms)) {
    try {
      const reply = await fetch(address, { cache: "no-store", credentials: "same-origin", ...options });
      if (reply.status === 401 || reply.status === 410) {
        location.replace("./"); // the first page says why there is no session
        return new Promise(() => {});
      }
      if (reply.ok || reply.status === 409) {
        const said = await reply.json();
        trouble("");
        return said;
      }
      if (reply.status < 500) throw new Refused(String(reply.status));
    } catch (error) {
      if (error instanceof Refused) {
        location.reload(); // the server knows where we are
        return new Promise(() => {});
      }
    }
    trouble(texts.lost);
    await pause(wait);
  }
}

class Refused extends Error {}

function trouble(text, again) {
  $("trouble").hidden = !text;
  $("trouble_text").textContent = text;
  $("again").hidden = !again;
  $("again").onclick = again || null;
}

// -- one trial ------------------------------------------------------------------------------------------------------

// `attempt` above 0: its videos are loaded once more, past what the browser has kept of them
function show(said, attempt = 0) {
  if (said.done) {
    location.replace("done");
    return;
  }
  trial = said;
  sending = false;
  look = {
    started: null, // ms: both began to play for the first time
    open: null, // ms: an answer became possible
    ended: { left: false, right: false },
    both: false, // both play, or wait for one another
    replays: { left: 0, right: 0 },
    watched: { left: 0, right: 0 },
    from: { left: 0, right: 0 }, // s: where the present stretch began
    offsets: { left: [], right: [] }, // ms: when a frame was shown less its time in the video
    differences: [], // s: right less left, where the browser does not say when frames are shown
    stalls: 0,
    loads: loads(said.trial),
    attempt,
  };
  $("question").textContent = said.question;
  const practice = said.kind === "practice" ? texts.practice + " · " : "";
  $("progress").textContent = practice + texts.progress.replace("{trial}", said.trial).replace("{of}", said.of);
  $("bar").setAttribute("aria-valuemax", said.of);
  $("bar").setAttribute("aria-valuenow", said.trial - 1);
  $("done").style.width = (100 * (said.trial - 1)) / said.of + "%";
  $("tie").hidden = !said.tie;
  $("play").disabled = true;
  $("play").textContent = texts.play;
  $("play").classList.remove("again");
  enable(false);
  trouble("");
  hint(texts.loading);
  if (document.activeElement) document.activeElement.blur();
  place(attempt);
}

function loads(number) {
  try {
    const [of, count] = (sessionStorage.getItem("loads") || "").split(":").map(Number);
    const now = of === number ? count + 1 : 1;
    sessionStorage.setItem("loads", number + ":" + now);
    return now;
  } catch {
    return 1;
  }
}

function hint(text) {
  $("hint").textContent = text;
  $("hint").classList.toggle("check", text === texts.check_left || text === texts.check_right);
}

const keys = () => !matchMedia("(pointer: coarse)").matches;

function enable(on) {
  for (const id of ["left", "right", "tie"]) $(id).disabled = !on;
}

function make(address) {
  const video = document.createElement("video");
  video.playsInline = true;
  video.setAttribute("playsinline", "");
  video.muted = true;
  video.preload = "auto";
  video.disablePictureInPicture = true;
  video.disableRemotePlayback = true;
  video.tabIndex = -1;
  video.src = address;
  video.load();
  return video;
}

// Put this trial's videos in their places; those that were loaded ahead are used.
async function place(attempt) {
  const mine = trial;
  const old = Object.values(videos);
  videos = {};
  for (const side of SIDES) {
    const address = trial[side];
    const loaded = attempt === 0 && shelf[address] && !shelf[address].error;
    const video = loaded ? shelf[address] : make(attempt ? `${address}?attempt=${attempt}` : address);
    if (loaded) delete shelf[address];
    videos[side] = video;
    wire(side, video);
    $("side_" + side).replaceChildren(video);
  }
  for (const video of [...old, ...Object.values(shelf)]) drop(video);
  shelf = {};
  try {
    await Promise.all(SIDES.map((side) => ready(videos[side])));
  } catch {
    if (mine !== trial) return;
    hint("");
    trouble(texts.broken, () => show(mine, attempt + 1));
    return;
  }
  if (mine !== trial) return;
  $("play").disabled = false;
  hint(texts.watch);
  for (const address of trial.next) {
    if (!shelf[address]) {
      shelf[address] = make(address);
      shelfPlace().append(shelf[address]);
    }
  }
  if (trial.autoplay) playBoth();
}

function shelfPlace() {
  let box = document.querySelector(".shelf");
  if (!box) {
    box = document.createElement("div");
    box.className = "shelf";
    box.setAttribute("aria-hidden", "true");
    document.body.append(box);
  }
  return box;
}

function drop(video) {
  video.pause();
  video.removeAttribute("src");
  video.load(); // frees the decoder: phones have few
  video.remove();
}

// Loaded as far as needed to play through; phones that load nothing before a press are let go on after a while.
function ready(video) {
  return new Promise((resolve, reject) => {
    if (video.error) return reject(video.error);
    if (video.readyState >= 4) return resolve();
    const timer = setTimeout(resolve, LIMITS.wait_ms);
    const end = (then) => () => {
      clearTimeout(timer);
      then();
    };
    video.addEventListener("canplaythrough", end(resolve), { once: true });
    video.addEventListener("error", end(() => reject(video.error)), { once: true });
  });
}

function wire(side, video) {
  const mine = trial;
  const current = () => mine === trial && videos[side] === video;
  const other = SIDES[1 - SIDES.indexOf(side)];
  video.onended = () => {
    if (!current()) return;
    bank(side);
    look.ended[side] = true;
    if (SIDES.every((one) => videos[one].ended || videos[one].paused)) look.both = false;
    if (look.open === null && look.ended.left && look.ended.right) open();
  };
  video.onwaiting = () => {
    if (!current() || !look.both || look.started === null || videos[other].ended) return;
    look.stalls += 1; // one ran dry: the other waits for it
    videos[other].pause();
    video.addEventListener("canplay", () => current() && look.both && run(other), { once: true });
  };
  video.onerror = () => {
    if (current() && look.started !== null && !sending) trouble(texts.broken, () => show(mine, look.attempt + 1));
  };
  video.onclick = () => current() && replay(side);
}

function bank(side) {
  look.watched[side] += Math.max(0, videos[side].currentTime - look.from[side]);
  look.from[side] = videos[side].currentTime;
}

function toStart(side) {
  const video = videos[side];
  bank(side);
  video.pause();
  look.from[side] = 0;
  if (video.currentTime === 0) return Promise.resolve();
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, 2000);
    video.addEventListener("seeked", () => (clearTimeout(timer), resolve()), { once: true });
    video.currentTime = 0;
  });
}

function run(side) {
  return Promise.resolve(videos[side].play());
}

let starting = false;

async function playBoth() {
  if (starting || sending || $("play").disabled) return;
  starting = true;
  const mine = trial;
  const first = look.started === null;
  try {
    look.both = false;
    if (!first) {
      for (const side of SIDES) look.replays[side] += 1;
      await Promise.all(SIDES.map(toStart));
      if (mine !== trial) return;
    }
    sounds(SIDES);
    look.both = true;
    if (first) watchFrames();
    await Promise.all(SIDES.map(run)); // both in one go, one right after the other
    if (mine !== trial) return;
    if (first && Math.abs(videos.left.currentTime - videos.right.currentTime) > LIMITS.apart_s) {
      look.stalls += 1; // one was not loaded yet: once more from the start, now that both are
      await Promise.all(SIDES.map(toStart));
      look.watched = { left: 0, right: 0 };
      look.offsets = { left: [], right: [] };
      look.differences = [];
      if (mine !== trial) return;
      await Promise.all(SIDES.map(run));
      if (mine !== trial) return;
    }
    if (first) {
      look.started = performance.now();
      hint(texts.watching);
    }
    $("play").textContent = texts.replay;
    $("play").classList.add("again");
  } catch (error) {
    if (mine !== trial) return;
    look.both = false;
    if (error && error.name === "NotAllowedError") {
      await Promise.all(SIDES.map(toStart)); // the browser wants a press first: the button is there
    } else if (error && error.name !== "AbortError") trouble(texts.broken, () => show(mine, look.attempt + 1));
  } finally {
    starting = false;
  }
}

async function replay(side) {
  if (starting || sending || look.open === null) return; // the first time both are seen together
  starting = true;
  const mine = trial;
  try {
    look.both = false;
    const other = SIDES[1 - SIDES.indexOf(side)];
    bank(other);
    videos[other].pause();
    look.replays[side] += 1;
    await toStart(side);
    if (mine !== trial) return;
    sounds([side]);
    await run(side);
  } catch {
    // a press on another button came between
  } finally {
    starting = false;
  }
}

function sounds(playing) {
  for (const side of SIDES) {
    const heard = trial.sound === "both" || (trial.sound === "left" && side === playing[0]);
    videos[side].muted = trial.sound === "off" || !heard || !playing.includes(side);
  }
}

// When each frame of the first showing came to the screen; from this the page knows by how much the starts differed.
function watchFrames() {
  const mine = trial;
  const active = () => mine === trial && look.open === null;
  if ("requestVideoFrameCallback" in HTMLVideoElement.prototype) {
    for (const side of SIDES) {
      const next = (now, frame) => {
        if (!active()) return;
        if (frame.mediaTime > 0) look.offsets[side].push(frame.expectedDisplayTime - 1000 * frame.mediaTime);
        videos[side].requestVideoFrameCallback(next);
      };
      videos[side].requestVideoFrameCallback(next);
    }
    return;
  }
  const next = () => {
    if (!active()) return;
    const [left, right] = SIDES.map((side) => videos[side]);
    if (!left.paused && !right.paused && left.currentTime > 0 && right.currentTime > 0)
      look.differences.push(right.currentTime - left.currentTime);
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
}

function middle(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const half = Math.floor(sorted.length / 2);
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

// s by which the left video started later than the right one; null if it could not be seen
function drift() {
  const { left, right } = look.offsets;
  if (left.length && right.length) return (middle(left) - middle(right)) / 1000;
  return look.differences.length ? middle(look.differences) : null;
}

function open() {
  look.open = performance.now();
  enable(true);
  hint(trial.instructed ? texts["check_" + trial.instructed] : keys() ? texts.choose : texts.choose_touch);
}

// -- the answer -----------------------------------------------------------------------------------------------------

function nonce() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

const round = (seconds) => (seconds === null ? null : Math.round(seconds * 1e4) / 1e4);

async function answer(choice) {
  if (sending || look === null || look.open === null || (choice === "tie" && !trial.tie)) return;
  sending = true;
  const now = performance.now();
  enable(false);
  $("play").disabled = true;
  for (const side of SIDES) {
    bank(side);
    videos[side].pause();
  }
  const body = {
    trial: trial.trial,
    nonce: nonce(), // the same at every attempt: the server takes the answer once
    choice,
    measures: {
      response_time_s: round((now - look.started) / 1000),
      choice_time_s: round((now - look.open) / 1000),
      replays_left: look.replays.left,
      replays_right: look.replays.right,
      watched_left_s: round(look.watched.left),
      watched_right_s: round(look.watched.right),
      start_drift_s: round(drift()),
      stalls_n: look.stalls,
      loads_n: look.loads,
      shown_width_px: Math.round(videos.left.getBoundingClientRect().width),
    },
  };
  show(
    await ask("answer", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    }),
  );
}

for (const id of ["left", "right", "tie"]) $(id).addEventListener("click", () => answer(id));
$("play").addEventListener("click", () => {
  $("play").blur();
  playBoth();
});

document.addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || trial === null) return;
  const focused = document.activeElement;
  if (event.key === " " && focused && ["BUTTON", "A"].includes(focused.tagName)) return; // presses that button
  const does = {
    ArrowLeft: () => answer("left"),
    ArrowRight: () => answer("right"),
    ArrowDown: () => answer("tie"),
    " ": playBoth,
  }[event.key];
  if (does && (event.key !== "ArrowDown" || trial.tie)) {
    event.preventDefault();
    does();
  }
});

window.addEventListener("pageshow", (event) => event.persisted && location.reload()); // the way back shows no old pair

ask("state").then((said) => show(said));
