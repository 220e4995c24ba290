"""The live view's server: who may ask, over HTTP and websocket, and that many pages see one session."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from http.cookies import SimpleCookie
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import live_chip
import numpy as np
import pytest

from workbench.app import guard
from workbench.app.section_fields import SectionFields
from workbench.app.server import Drawing, LiveView
from workbench.render.live import LivePicture, live_pictures

aiohttp = pytest.importorskip("aiohttp")
msgpack = pytest.importorskip("msgpack")
pytest.importorskip("trame_vuetify")

#: Seconds that anything may take here before a test fails: many times what it takes.
PATIENCE = 60.0


def section(found: SectionFields) -> Iterator[LivePicture]:
    return live_pictures(found.fields, found.traps)


@contextlib.asynccontextmanager
async def served(folder: Path) -> AsyncIterator[LiveView]:
    view = LiveView(live_chip.session(folder), Drawing(section, lambda found: b""), folder, live_chip.diagnosing)
    ready = asyncio.Event()
    serving = asyncio.ensure_future(view.serve(0, lambda address: ready.set()))
    try:
        await asyncio.wait_for(ready.wait(), PATIENCE)
        yield view
    finally:
        serving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await serving


def run(test: Callable[[LiveView], Awaitable[None]], folder: Path) -> None:
    async def whole() -> None:
        async with served(folder) as view:
            await asyncio.wait_for(test(view), PATIENCE)

    asyncio.run(whole())


def base(view: LiveView) -> str:
    return view.address.partition("/index")[0]


def port(view: LiveView) -> int:
    return int(base(view).rpartition(":")[2])


class Client:
    """A page without a browser: the calls of wslink, each answered by its id, and all that is published."""

    def __init__(self, socket: Any) -> None:
        from wslink.chunking import UnChunker

        self.socket, self.state, self.count = socket, dict[str, Any](), 0
        self.parts = UnChunker()
        self.parts.set_max_message_size(1 << 30)

    async def receive(self) -> Any:
        """The next whole message; what was published of the state is kept."""
        found = None
        while found is None:
            message = await self.socket.receive()
            assert message.type is aiohttp.WSMsgType.BINARY, message
            found = self.parts.process_chunk(message.data)
        if str(found.get("id", "")).startswith("publish:trame.state.topic"):
            self.state |= found["result"]
        return found

    async def call(self, method: str, *arguments: Any) -> Any:
        from wslink.chunking import generate_chunks

        self.count += 1
        name = f"{'system' if method == 'wslink.hello' else 'rpc'}:c0:{self.count}"
        content = {"wslink": "1.0", "id": name, "method": method, "args": list(arguments), "kwargs": {}}
        for part in generate_chunks(msgpack.packb(content), 0):
            await self.socket.send_bytes(part)
        while True:
            found = await self.receive()
            if found.get("id") == name:
                assert "error" not in found, found
                return found["result"]

    async def until(self, holds: Callable[[dict[str, Any]], bool]) -> None:
        while not holds(self.state):
            await self.receive()


@contextlib.asynccontextmanager
async def opened(view: LiveView) -> AsyncIterator[Client]:
    async with aiohttp.ClientSession() as session, session.ws_connect(
            f"{base(view)}/ws?token={view.token}", headers={"Origin": base(view)}, max_msg_size=0) as socket:
        client = Client(socket)
        await client.call("wslink.hello", {"secret": "wslink-secret"})
        client.state |= (await client.call("trame.state.get"))["state"]
        yield client


def headers(view: LiveView) -> dict[str, dict[str, str]]:
    """Headers that are wrong in one way each."""
    number = port(view)
    return {
        "rebound name": {"Host": f"attacker.example:{number}"}, "no port": {"Host": "127.0.0.1"},
        "another name": {"Host": f"localhost:{number}"},
        "other port": {"Host": f"127.0.0.1:{number + 1}"}, "lookalike": {"Host": f"127.0.0.1.example:{number}"},
        "foreign page": {"Origin": "http://attacker.example"}, "foreign port": {"Origin": "http://127.0.0.1:1"},
        "hidden page": {"Origin": "null"}, "secure page": {"Origin": f"https://127.0.0.1:{number}"},
    }


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_who_may_not_ask_is_refused(tmp_path: Path) -> None:
    async def test(view: LiveView) -> None:
        here = base(view)
        async with aiohttp.ClientSession() as session:
            async def status(path: str, **sent: str) -> int:
                async with session.get(here + path, headers=sent, allow_redirects=False) as response:
                    return int(response.status)

            async def upgraded(path: str, **sent: str) -> int:
                try:
                    async with session.ws_connect(here + path, headers=sent):
                        return 101
                except aiohttp.WSServerHandshakeError as refused:
                    return int(refused.status)

            cookie = f"{guard.cookie_name(port(view))}={view.token}"
            right = f"?token={view.token}"
            assert await status("/index.html" + right) == 200
            assert await status("/vue.global.js", Cookie=cookie) == 200
            assert await upgraded("/ws" + right) == 101
            assert await upgraded("/ws", Cookie=cookie, Origin=here) == 101
            for path in ("/", "/index.html", "/vue.global.js", "/nothing", "/diagnosis/report.html", "/paraview/"):
                assert await status(path) == 403
                assert await status(f"{path}?token=") == 403
                assert await status(f"{path}?token={view.token[:-1]}") == 403
                assert await status(f"{path}?token={view.token}x", Cookie=cookie) == 403
                assert await status(f"{path}?token={view.token}&token=x") == 403
            assert await upgraded("/ws") == 403
            assert await upgraded("/ws?token=" + view.token[::-1]) == 403
            assert await upgraded("/ws", Cookie=cookie[:-1]) == 403
            for wrong in headers(view).values():
                for path in ("/index.html", "/assets/x.js", "/"):
                    assert await status(path + right, **wrong) == 403, wrong
                assert await upgraded("/ws" + right, **wrong) == 403, wrong
                assert await upgraded("/ws", Cookie=cookie, **wrong) == 403, wrong

    run(test, tmp_path)


def test_the_page_sets_its_cookie_and_allows_nothing_from_outside(tmp_path: Path) -> None:
    async def test(view: LiveView) -> None:
        async with aiohttp.ClientSession() as session, session.get(view.address) as response:
            (morsel,) = SimpleCookie(response.headers["Set-Cookie"]).values()
            assert morsel.value == view.token
            assert (morsel["httponly"], morsel["samesite"], morsel["domain"]) == (True, "Strict", "")
            policy = response.headers["Content-Security-Policy"]
            assert "default-src 'self'" in policy
            assert "http" not in policy
            assert response.headers["Referrer-Policy"] == "no-referrer"
        async with aiohttp.ClientSession() as session, session.get(base(view)) as response:
            assert response.status == 403
            assert "Set-Cookie" not in response.headers
            assert view.token not in await response.text()

    run(test, tmp_path)


def test_it_listens_on_loopback_only(tmp_path: Path) -> None:
    async def test(view: LiveView) -> None:
        wslink = view._server._server
        assert {address[0] for address in wslink.runner.addresses} == {"127.0.0.1"}

    run(test, tmp_path)


def test_ten_pages_at_once_see_what_one_of_them_moves(tmp_path: Path) -> None:
    async def test(view: LiveView) -> None:
        async with contextlib.AsyncExitStack() as stack:
            pages = await asyncio.gather(*(stack.enter_async_context(opened(view)) for _ in range(10)))
            ready = "model ready"
            await asyncio.gather(*(page.until(lambda s: ready in s["works"].get("model", {}).get("text", ""))
                                   for page in pages))
            await asyncio.gather(*(page.until(lambda s: bool(s["pictures"])) for page in pages))
            before = pages[0].state["curve"]["magnitude"]
            index = [row["name"] for row in pages[0].state["rows"]].index("substrate.thickness")
            await pages[3].call("trame.state.update", [{"key": f"x_{index}", "value": 0.79}])
            await asyncio.gather(*(page.until(lambda s: s["curve"]["magnitude"] != before) for page in pages))
            assert len({page.state["curve"]["magnitude"] for page in pages}) == 1
            assert view.session.values["substrate.thickness"] == pytest.approx(0.79e-3, rel=1e-12)
            await pages[7].call("trame.trigger", "pick", [0.5], {})
            await asyncio.gather(*(page.until(lambda s: not s["shown"]["follows"]) for page in pages))
            assert {page.state["shown"]["text"] for page in pages} == {pages[7].state["shown"]["text"]}
            await pages[5].call("trame.trigger", "undo", [], {})
            await asyncio.gather(*(page.until(lambda s: s["curve"]["magnitude"] == before) for page in pages))

    run(test, tmp_path)


def test_files_are_saved_under_plain_names_and_nothing_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "out"

    async def test(view: LiveView) -> None:
        view.folder = folder
        async with opened(view) as page:
            for name in ("../out.toml", "/tmp/x.toml", "chip.txt", "", ".toml", "a/b.toml", 7):
                await page.call("trame.trigger", "save", [name], {})
                assert view._state.message_is_error, name
            assert not folder.exists()
            await page.call("trame.trigger", "save", ["moved.toml"], {})
            assert not view._state.message_is_error
            # Its own file may be written again; another's may not.
            await page.call("trame.trigger", "save", ["moved.toml"], {})
            assert not view._state.message_is_error
            (folder / "other.toml").write_text("mine")
            await page.call("trame.trigger", "save", ["other.toml"], {})
            assert view._state.message_is_error
            assert (folder / "other.toml").read_text() == "mine"
            assert [path.name for path in sorted(folder.iterdir())] == ["moved.toml", "other.toml"]

    run(test, tmp_path)


def test_nonsense_from_a_page_is_told_and_changes_nothing(tmp_path: Path) -> None:
    async def test(view: LiveView) -> None:
        before = view.session.values
        async with opened(view) as page:
            for value in ("nonsense", None, float("nan"), -1.0, [1], 1e9):
                await page.call("trame.state.update", [{"key": "x_0", "value": value}])
                assert view.session.values == before, value
                assert view._state.message_is_error, value
            for call in (["enter", ["no such", "1"]], ["enter", ["substrate.thickness", "0,81"]],
                         ["enter", ["substrate.thickness", None]], ["tolerate", ["substrate.thickness", "0,81"]],
                         ["tolerate", ["no such", "1"]], ["tolerate", ["substrate.thickness", "x"]],
                         ["tolerate", ["substrate.thickness", "-1"]]):
                await page.call("trame.trigger", *call, {})
                assert view._state.message_is_error, call
                assert view._state.message, call
            await page.call("trame.trigger", "free", ["no such", True], {})
            assert not view.works.free

    run(test, tmp_path)


def test_a_refusal_says_why() -> None:
    def request(**changed: Any) -> Any:
        from multidict import CIMultiDict

        transport = SimpleNamespace(get_extra_info=lambda name: ("127.0.0.1", 8080))
        sent = CIMultiDict({"Host": "127.0.0.1:8080", **changed.get("headers", {})})
        return SimpleNamespace(transport=transport, headers=sent, query=CIMultiDict(changed.get("query", {})),
                               cookies=changed.get("cookies", {}))

    assert guard.refusal(request(query={"token": "right"}), "right") == ""
    assert guard.refusal(request(cookies={"workbench_8080": "right"}), "right") == ""
    assert "token" in guard.refusal(request(cookies={"workbench_8081": "right"}), "right")
    assert "token" in guard.refusal(request(query={"token": "wröng"}), "right")
    assert "host" in guard.refusal(request(headers={"Host": "a.example:8080"}, query={"token": "right"}), "right")
    assert "origin" in guard.refusal(request(headers={"Origin": "http://a"}, query={"token": "right"}), "right")
    assert len({guard.new_token() for _ in range(50)}) == 50
    assert all(len(guard.new_token()) >= 32 for _ in range(np.int64(3)))
