"""The web pages of a study: consent, instructions, trials, thanks, withdrawal; a Starlette application.

A participant is known by a random key in a cookie, signed by the server: nobody can name another's. The server alone
knows which trial comes next and what stands on which side; a browser says only left, right or no difference, and is
told of the next trial only when the answer is on disk. Videos go by names that say nothing of what they are.

Needs the extra `web` (starlette, uvicorn).
"""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import html
import json
import math
import mimetypes
import re
import secrets
import sys
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from urllib.parse import parse_qsl

from study.design import Design, Trial, load_design
from study.errors import InputError
from study.markdown import to_html
from study.settings import PAGES, Settings, load_page, load_settings
from study.store import (
    ACTIVE,
    DONE,
    MEASURES,
    REFUSED,
    REPLACED,
    FaultError,
    FullError,
    Session,
    Store,
    TakenError,
    is_postgres,
)

try:
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.exceptions import HTTPException
    from starlette.requests import ClientDisconnect, Request
    from starlette.responses import FileResponse, HTMLResponse, JSONResponse, RedirectResponse, Response
    from starlette.routing import Route
except ImportError:
    raise InputError(
        "expected the packages starlette and uvicorn to serve a study, found none; run: pip install 'lipmetrics[web]'"
    ) from None

COOKIE = "study"
BODY_LIMIT_BYTES = 16384
COOKIE_AGE_S = 30 * 86400
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; media-src 'self'; "
    "img-src data:; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
_STATIC = {"study.css": "text/css; charset=utf-8", "study.js": "text/javascript; charset=utf-8"}
_NONCE = re.compile(r"[A-Za-z0-9_-]{16,64}")
_OUTSIDE_ID = re.compile(r"[A-Za-z0-9._-]{1,100}")
_CHOICES = ("left", "right", "tie")


@dataclasses.dataclass(frozen=True)
class Study:
    """All that is served.

    Parameters
    ----------
    design, settings : of the study's folder
    pages : HTML of `settings.PAGES`
    media : opaque name -> file, for the videos of the design and nothing else
    name_of : code -> opaque name
    store : where answers go
    """

    design: Design
    settings: Settings
    pages: Mapping[str, str]
    media: Mapping[str, Path]
    name_of: Mapping[str, str]
    store: Store


def open_study(folder: str | Path) -> Study:
    """The study in a folder that `lipmetrics study design` made, with its database.

    Raises
    ------
    InputError : something is missing or wrong; a video is not the one that the design was made of
    """
    folder = Path(folder)
    design, settings = load_design(folder), load_settings(folder)
    pages = {name: to_html(load_page(folder, name)) for name in PAGES}
    media, name_of = {}, {}
    for one in design.stimuli:
        if not one.file:
            raise InputError(
                f"expected videos to serve, got the bare code {one.code}; make the design of a folder of videos"
            )
        path = folder / one.file
        try:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise InputError(f"expected the video {path} of the design, but: {error.strerror or error}") from None
        if digest != one.sha256:
            raise InputError(
                f"expected {path} as it was when the design was made, got another content; make a new design"
            )
        ending = path.suffix.lower()
        name = hashlib.blake2b(f"{design.identity} {one.code}".encode(), digest_size=12).hexdigest() + ending
        media[name], name_of[one.code] = path, name
    store = Store(
        settings.database if is_postgres(settings.database) else folder / settings.database,
        design.identity,
        len(design.sessions),
        abandoned_after_s=3600 * settings.abandoned_after_h,
    )
    return Study(design, settings, pages, media, name_of, store)


def make_app(study: Study) -> Starlette:
    """The application that serves a study."""
    views = _Views(study)
    app = Starlette(
        routes=[
            Route("/", views.consent),
            Route("/begin", views.begin, methods=["POST"]),
            Route("/instructions", views.instructions),
            Route("/trials", views.trials),
            Route("/state", views.state),
            Route("/answer", views.answer, methods=["POST"]),
            Route("/done", views.done),
            Route("/withdraw", views.withdraw_question, methods=["GET"]),
            Route("/withdraw", views.withdraw, methods=["POST"]),
            Route("/media/{name}", views.video),
            Route("/static/{name}", views.static),
        ],
        exception_handlers={HTTPException: views.refuse, ClientDisconnect: views.gone, FaultError: views.fail},
    )
    app.add_middleware(_Headers)
    return app


class _Headers:
    """Adds `HEADERS` to every reply, and tells caches to keep none but videos."""

    def __init__(self, app):
        self.app = app
        self.headers = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]

    async def __call__(self, scope, receive, send):
        async def send_with_headers(message):
            if message["type"] == "http.response.start":
                headers = [*message["headers"], *self.headers]
                if not any(name == b"cache-control" for name, _ in headers):
                    headers.append((b"cache-control", b"no-store"))
                message = {**message, "headers": headers}
            await send(message)

        await self.app(scope, receive, send_with_headers)


class _Views:
    def __init__(self, study: Study):
        self.study, self.store = study, study.store
        self.settings, self.texts = study.settings, study.settings.texts
        pages = files("study") / "pages"
        self.page_html = (pages / "page.html").read_text(encoding="utf-8")
        self.trials_html = (pages / "trials.html").read_text(encoding="utf-8")
        self.static_files = {name: (pages / name).read_bytes() for name in _STATIC}

    # -- pages ------------------------------------------------------------------------------------

    async def consent(self, request: Request) -> Response:
        ids = self.outside_ids(request.query_params)
        session = await self.session(request)
        if session is not None and ids and session.person != next(iter(ids.values())):
            session = None  # somebody else at this browser
        if session is not None and session.state == ACTIVE:
            return self.go("trials" if session.answered_n else "instructions")
        if session is not None and session.state == DONE and not self.settings.shared_computer:
            return self.go("done")
        if session is not None and session.state == REPLACED:
            return self.page(f"<p>{self.text('expired')}</p>", 410)
        if self.settings.id_parameters and self.settings.id_parameters[0] not in ids:
            return self.page(f"<p>{self.text('missing_id')}</p>", 400)
        key = secrets.token_urlsafe(24)
        fields = {"key": f"{key}.{self.signature(key)}"} | ids
        hidden = "\n".join(
            f'<input type="hidden" name="{html.escape(name)}" value="{html.escape(value)}">'
            for name, value in fields.items()
        )
        form = f"""<form method="post" action="begin">
{hidden}
<button class="main" name="agree" value="yes">{self.text("agree")}</button>
</form>
<noscript><p class="notice">{self.text("no_script")}</p></noscript>"""
        return self.page(self.study.pages["consent"] + form)

    async def begin(self, request: Request) -> Response:
        form = await self.form(request)
        key = self.checked(form.get("key", ""))
        if key is None or form.get("agree") != "yes":
            raise HTTPException(400)
        ids = self.outside_ids(form)
        if self.settings.id_parameters and self.settings.id_parameters[0] not in ids:
            return self.page(f"<p>{self.text('missing_id')}</p>", 400)
        try:
            await run_in_threadpool(self.store.begin, key, ids)
        except FullError:
            return self.page(f"<p>{self.text('full')}</p>", 410)
        except TakenError:
            return self.page(f"<p>{self.text('taken')}</p>", 409)
        reply = self.go("instructions")
        secure = request.url.scheme == "https"
        reply.set_cookie(
            COOKIE, form["key"], max_age=COOKIE_AGE_S, path="/", httponly=True, samesite="lax", secure=secure
        )
        return reply

    async def instructions(self, request: Request) -> Response:
        session = await self.session(request)
        if session is None or session.state != ACTIVE:
            return self.astray(request, session)
        button = f'<p><a class="button main" href="trials">{self.text("begin")}</a></p>'
        return self.page(self.study.pages["instructions"] + button, footer=True)

    async def trials(self, request: Request) -> Response:
        session = await self.session(request)
        if session is None or session.state != ACTIVE:
            return self.astray(request, session)
        names = ("left", "right", "tie", "play", "again", "withdraw", "no_script")
        words = {name: self.text(name) for name in names} | self.frame()
        words["progress_label"] = html.escape(self.settings.title)
        words["texts"] = json.dumps(dict(self.texts)).replace("<", "\\u003c")
        return HTMLResponse(_fill(self.trials_html, words))

    async def done(self, request: Request) -> Response:
        session = await self.session(request)
        if session is None or session.state != DONE:
            return self.astray(request, session)
        parts = [self.study.pages["thanks"]]
        if self.settings.completion_code:
            code = html.escape(self.settings.completion_code)
            parts.append(f'<p>{self.text("code")} <span class="code">{code}</span></p>')
        if self.settings.completion_url:
            address = html.escape(self.settings.completion_url)
            parts.append(f'<p><a class="button main" href="{address}" rel="noreferrer">{self.text("back")}</a></p>')
        return self.page("\n".join(parts), footer=True)

    async def withdraw_question(self, request: Request) -> Response:
        if await self.session(request) is None:
            return self.go("./")
        return self.page(
            f"""<h1>{self.text("withdraw")}</h1>
<p>{self.text("withdraw_question")}</p>
<form method="post" action="withdraw">
<button name="sure" value="yes">{self.text("withdraw_yes")}</button>
<a class="button main" href="./">{self.text("withdraw_no")}</a>
</form>"""
        )

    async def withdraw(self, request: Request) -> Response:
        form = await self.form(request)
        key = self.checked(request.cookies.get(COOKIE, ""))
        if key is None or form.get("sure") != "yes":
            raise HTTPException(400)
        await run_in_threadpool(self.store.withdraw, key)
        reply = self.page(f"<p>{self.text('withdrawn')}</p>")
        reply.delete_cookie(COOKIE, path="/")
        return reply

    # -- trials -----------------------------------------------------------------------------------

    async def state(self, request: Request) -> Response:
        return self.told(await self.session(request))

    async def answer(self, request: Request) -> Response:
        key = self.checked(request.cookies.get(COOKIE, ""))
        if key is None:
            return JSONResponse({"error": "no session"}, 401)
        if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
            return JSONResponse({"error": "expected application/json"}, 415)
        raw = await self.body(request)
        session = await run_in_threadpool(self.store.session, key)
        if session is None or session.state == REPLACED:
            return self.told(session)
        trials = self.study.design.sessions[session.slot]
        try:
            number, nonce, choice, measures = _read_answer(raw, len(trials))
        except ValueError as error:
            return JSONResponse({"error": str(error)}, 422)
        trial = trials[number - 1]
        if choice == "tie" and not (self.settings.tie_allowed and not trial.instructed):
            return JSONResponse({"error": "expected left or right"}, 422)
        outcome, session = await run_in_threadpool(
            self.store.answer,
            key,
            number,
            nonce,
            left=trial.left,
            right=trial.right,
            chosen={"left": trial.left, "right": trial.right, "tie": ""}[choice],
            last=number == len(trials),
            measures=measures,
        )
        return self.told(session, 409 if outcome == REFUSED else 200)

    def told(self, session: Session | None, status: int = 200) -> Response:
        """What a browser may know: the trial whose turn it is, and which videos to load ahead."""
        if session is None:
            return JSONResponse({"error": "no session"}, 401)
        if session.state == REPLACED:
            return JSONResponse({"error": "expired"}, 410)
        trials = self.study.design.sessions[session.slot]
        if session.state == DONE:
            return JSONResponse({"done": True, "of": len(trials)}, status)
        trial = trials[session.answered_n]
        ahead = trials[session.answered_n + 1 : session.answered_n + 2]
        return JSONResponse(
            {
                "done": False,
                "trial": trial.trial,
                "of": len(trials),
                "kind": "practice" if trial.kind == "practice" else "trial",  # a catch trial looks like any other
                "left": self.address(trial.left),
                "right": self.address(trial.right),
                "sound": self.settings.sound if self.study.design.stimulus(trial.left).audio else "off",
                "question": self.settings.question,
                "tie": self.settings.tie_allowed and not trial.instructed,
                "instructed": _side(trial) if trial.instructed else "",
                "autoplay": self.settings.autoplay,
                "next": sorted({self.address(code) for one in ahead for code in (one.left, one.right)}),
            },
            status,
        )

    def address(self, code: str) -> str:
        return f"media/{self.study.name_of[code]}"

    # -- files ------------------------------------------------------------------------------------

    async def video(self, request: Request) -> Response:
        path = self.study.media.get(request.path_params["name"])
        if path is None:
            raise HTTPException(404)
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        return FileResponse(path, media_type=kind, headers={"Cache-Control": "private, max-age=86400, immutable"})

    async def static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self.static_files:
            raise HTTPException(404)
        return Response(self.static_files[name], media_type=_STATIC[name], headers={"Cache-Control": "no-cache"})

    # -- faults -----------------------------------------------------------------------------------

    async def refuse(self, request: Request, error: HTTPException) -> Response:
        return self.page(f"<p>{self.text('unknown')}</p>", error.status_code)

    async def gone(self, request: Request, error: Exception) -> Response:
        return Response(status_code=400)

    async def fail(self, request: Request, error: Exception) -> Response:
        """A fault of the database: the operator sees which, the browser asks again."""
        print(f"lipmetrics study: the database says: {error}", file=sys.stderr)
        return Response("The study has a fault just now; please try again.", 503, media_type="text/plain")

    # -- parts ------------------------------------------------------------------------------------

    def page(self, main: str, status: int = 200, footer: bool = False) -> HTMLResponse:
        foot = f'<footer><a href="withdraw">{self.text("withdraw")}</a></footer>' if footer else ""
        return HTMLResponse(_fill(self.page_html, self.frame() | {"main": main, "footer": foot}), status)

    def frame(self) -> dict[str, str]:
        return {"language": html.escape(self.settings.language), "title": html.escape(self.settings.title)}

    def text(self, name: str) -> str:
        return html.escape(self.texts[name])

    def go(self, where: str) -> RedirectResponse:
        return RedirectResponse(where, 303)

    def astray(self, request: Request, session: Session | None) -> Response:
        """To where the session stands; who has none is told about cookies if the form has just been sent."""
        if session is None and request.url.path.endswith("/instructions") and COOKIE not in request.cookies:
            return self.page(f'<p>{self.text("cookies")}</p>\n<p><a href="./">{self.text("begin")}</a></p>', 400)
        if session is not None and session.state == DONE:
            return self.go("done")
        return self.go("./")

    async def session(self, request: Request) -> Session | None:
        key = self.checked(request.cookies.get(COOKIE, ""))
        return None if key is None else await run_in_threadpool(self.store.session, key)

    def signature(self, key: str) -> str:
        return hmac.new(self.store.secret, key.encode(), hashlib.sha256).hexdigest()[:32]

    def checked(self, signed: str) -> str | None:
        """The key, if this server signed it."""
        key, _, signature = signed.partition(".")
        return key if hmac.compare_digest(signature.encode(), self.signature(key).encode()) else None

    def outside_ids(self, fields: Mapping[str, str]) -> dict[str, str]:
        """Those that study.toml names, where they look like identities."""
        found = {name: fields.get(name, "") for name in self.settings.id_parameters}
        return {name: value for name, value in found.items() if _OUTSIDE_ID.fullmatch(value)}

    async def form(self, request: Request) -> dict[str, str]:
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind != "application/x-www-form-urlencoded":
            raise HTTPException(415)
        raw = await self.body(request)
        try:
            return dict(parse_qsl(raw.decode("ascii"), max_num_fields=20))
        except ValueError:
            raise HTTPException(400) from None

    async def body(self, request: Request) -> bytes:
        length = request.headers.get("content-length", "0")
        if not length.isdigit() or int(length) > BODY_LIMIT_BYTES:
            raise HTTPException(413)
        raw = b""
        async for piece in request.stream():
            raw += piece
            if len(raw) > BODY_LIMIT_BYTES:
                raise HTTPException(413)
        return raw


def _side(trial: Trial) -> str:
    return "left" if trial.expected == trial.left else "right"


def _fill(template: str, words: Mapping[str, str]) -> str:
    return re.sub(r"\{\{(\w+)\}\}", lambda match: words[match[1]], template)


def _read_answer(raw: bytes, trials_n: int) -> tuple[int, str, str, dict]:
    """Trial, nonce, choice and measures of an answer's JSON.

    Raises
    ------
    ValueError : it is anything else
    """

    try:
        said = json.loads(raw.decode("utf-8"))
    except RecursionError:
        raise ValueError("expected a flat object") from None
    if not isinstance(said, dict) or set(said) != {"trial", "nonce", "choice", "measures"}:
        raise ValueError("expected an object of trial, nonce, choice and measures")
    if type(said["trial"]) is not int or not 1 <= said["trial"] <= trials_n:
        raise ValueError(f"expected a trial from 1 to {trials_n}")
    if not isinstance(said["nonce"], str) or not _NONCE.fullmatch(said["nonce"]):
        raise ValueError("expected a nonce of 16 to 64 letters and digits")
    if said["choice"] not in _CHOICES:
        raise ValueError("expected a choice: left, right or tie")
    return said["trial"], said["nonce"], said["choice"], _read_measures(said["measures"])


def _read_measures(given) -> dict[str, float | None]:
    if not isinstance(given, dict) or not set(given) <= set(MEASURES):
        raise ValueError("expected the measures that the page sends")
    for name, value in given.items():
        whole = MEASURES[name] == "INTEGER"
        if value is None:
            continue
        if type(value) not in ((int,) if whole else (int, float)) or not math.isfinite(value) or abs(value) > 1e6:
            raise ValueError(f"expected {name} to be a {'whole ' if whole else ''}number")
        if value < 0 and name != "start_drift_s":
            raise ValueError(f"expected {name} not to be negative")
    return given


def serve(study: Study, listening, *, on_start=None) -> None:
    """Serve until Ctrl-C or SIGTERM.

    Parameters
    ----------
    listening : bound socket
    on_start : called once, before the first request can come
    """
    import uvicorn

    config = uvicorn.Config(
        make_app(study),
        access_log=False,
        server_header=False,
        log_level="warning",
        lifespan="off",
        timeout_keep_alive=75,  # s: longer than people look at a pair
    )
    if on_start is not None:
        on_start()
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        study.store.close()
