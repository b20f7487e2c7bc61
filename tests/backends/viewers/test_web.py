"""The page of the live view: what its messages do, what they cannot do, and how fast it is."""

from __future__ import annotations

import http.client
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from backends.viewers.disturbing import NOISES, ShownNumber
from backends.viewers.session import PLANT, Session
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tasks.spaces import anchor
from controllers.feeds import StepByStep
from controllers.jacobian import JacobianController

viser = pytest.importorskip("viser", reason="the extra `view` is not installed")
msgspec = pytest.importorskip("msgspec")
zstandard = pytest.importorskip("zstandard")
client = pytest.importorskip("websockets.sync.client")

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (3.0, 0.0, 1.0),
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 100,
    "image_width": 100,
    "look_at": (0.0, 0.0, 1.0),
    "up_direction": (0.0, 0.0, 1.0),
}


@pytest.fixture
def session(paper: Robot) -> Session:
    drivers = [StepByStep(JacobianController(paper), paper)]
    return Session(paper, ["mujoco", "pybullet"], anchor(paper), drivers)


@pytest.fixture
def url(session: Session) -> Iterator[str]:
    """Serve the session from a thread, and yield where."""
    from backends.viewers.web import WebView

    view, stop = WebView(session, port=0), threading.Event()
    loop = threading.Thread(target=view.run, args=(stop.is_set,))
    loop.start()
    yield view.url
    for page in Page.opened:  # the server waits for pages that are still there
        page.socket.socket.close()
    Page.opened.clear()
    stop.set()
    loop.join()
    view.close()


class Page:
    """A page in the words of viser: it keeps what it is told, and can say anything."""

    opened: ClassVar[list[Page]] = []

    def __init__(self, url: str) -> None:
        address = url.replace("http", "ws")
        protocol = f"viser-v{viser.__version__}"
        self.socket = client.connect(
            address, subprotocols=[protocol], max_size=None, ping_interval=None
        )
        self.messages: list[dict[str, Any]] = []
        self.opened.append(self)
        self.say(CAMERA)
        wait(lambda: self.hear() and self.uuid("cable 8 [m]"))

    def say(self, message: Mapping[str, object]) -> None:
        self.socket.send(msgspec.msgpack.encode(message))

    def hear(self) -> bool:
        """Take in what has arrived; a page that is kept up to date never hears the end."""
        try:
            for _ in range(50):
                raw = self.socket.recv(timeout=0.05)
                packed = raw[16 : 16 + int.from_bytes(raw[8:16], "little")]
                inner = zstandard.ZstdDecompressor().decompress(packed)
                self.messages += msgspec.msgpack.decode(inner)["messages"]
        except TimeoutError:
            pass
        return True

    def uuid(self, label: str) -> str:
        """Return how an element is called, or nothing if the page has not heard of it."""
        found = [m["uuid"] for m in self.messages if m.get("props", {}).get("label") == label]
        return found[0] if found else ""

    def set(self, label: str, value: object) -> None:
        self.say(
            {"type": "GuiUpdateMessage", "uuid": self.uuid(label), "updates": {"value": value}}
        )


def wait(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for a condition, and fail if it does not come."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)


def test_a_page_steers_the_session(url: str, session: Session) -> None:
    page, other = Page(url), Page(url)
    theme = next(m for m in page.messages if m["type"] == "ThemeConfigurationMessage")
    assert not theme["show_logo"]
    assert not theme["show_share_button"]
    page.set("cable 3 [m]", 2.5)
    wait(lambda: session.driving.command[2] == -2.5)
    page.set("Play", True)
    wait(lambda: session.time > 0.01)
    other.set("Play", True)  # the same button: it pauses
    wait(lambda: not session.playing)
    page.set("driver", "jacobian")
    wait(lambda: session.driving.name == "jacobian")
    page.set("link masses, factor", 2.0)
    wait(lambda: session.plant["link_mass"] == 2.0)
    page.set("observations lost, share", 0.5)
    wait(lambda: session.disturbing.noise["packet_loss"] == 0.5)
    page.set("Undisturbed", True)
    wait(lambda: session.disturbing.noise["packet_loss"] == 0.0)
    page.set("Push tip, -y", True)
    wait(lambda: (session.simulations[1].loads.force[0, -1, 0, 1:] < (0.0, 0.1)).all())
    before = session.target
    page.set("Next target", True)
    wait(lambda: session.seed == 1 and (session.target != before).all())
    place = [0.5, 0.1, 2.0]
    drag = {"type": "TransformControlsUpdateMessage", "name": "/engine0/handle", "owner": ""}
    page.say(drag | {"wxyz": [1, 0, 0, 0], "position": place})
    wait(lambda: session.target.tolist() == place)
    other.hear()
    moved = [m for m in other.messages if m["type"] == "SetPositionMessage"]
    assert any(np.allclose(m["position"], place) for m in moved)


def test_nonsense_from_a_page_hurts_nobody(url: str, session: Session) -> None:
    def update(label: str, **updates: object) -> Callable[[Page], None]:
        message = {"type": "GuiUpdateMessage", "updates": updates}
        return lambda page: page.say(message | {"uuid": page.uuid(label)})

    drag = {"type": "TransformControlsUpdateMessage", "name": "/engine0/handle", "owner": ""}
    nonsense: list[Callable[[Page], None]] = [
        lambda page: page.socket.send(b"\x00\xff\xc1 no message"),
        lambda page: page.socket.send("text"),
        lambda page: page.say({"type": "NoSuchMessage"}),
        lambda page: page.say({"type": "GuiUpdateMessage"}),
        lambda page: page.say({"type": "ShareUrlRequest"}),
        lambda page: page.socket.send(bytes(51 * 1024 * 1024)),
        update("cable 1 [m]", value=math.nan),
        update("cable 1 [m]", value=1e300),
        update("cable 1 [m]", value="much"),
        update("cable 1 [m]", value=None, no_such_property=1),
        update("seed of target", value=1e300),
        update("seed of target", value=0.5),
        update("driver", value="nobody" * 1000),
        update("speed", value=-1.0),
        lambda page: page.say(drag | {"wxyz": [0, 0, 0, 0], "position": [math.nan] * 3}),
        lambda page: page.say(drag | {"wxyz": [1, 0, 0, 0], "position": ["a", [], {}]}),
        lambda page: page.socket.socket.close(),
    ]
    watching = Page(url)
    for number, say in enumerate(nonsense, 1):
        say(Page(url))
        later = Page(url)  # one that comes after it gets everything, and can steer
        pull = 0.02 * number
        later.set("cable 2 [m]", pull)
        wait(lambda pull=pull: session.driving.command[1] == -pull)
        later.socket.close()
    watching.hear()
    assert session.driving.command[0] == 0
    assert session.seed == 0
    assert np.isfinite(session.target).all()
    assert not any(m["type"].startswith("ShareUrl") for m in watching.messages)
    wait(lambda: watching.hear() and "whole number" in watching_text(watching))


def watching_text(page: Page) -> str:
    """Return all texts that a page was shown."""
    return " ".join(str(m["updates"].get("_markdown", "")) for m in page.messages if "updates" in m)


def test_twenty_pages_come_and_vanish(url: str, session: Session) -> None:
    pages = [Page(url) for _ in range(20)]
    pages[0].set("Play", True)
    wait(lambda: session.playing)
    for page in pages[1:11]:
        page.socket.socket.close()  # without a word
    before = session.time
    wait(lambda: session.time > before + 0.01)
    for page in pages[11:]:
        page.messages.clear()
        wait(lambda page=page: page.hear() and page.messages)


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../../../../../etc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/..%2f..%2f..%2f..%2f..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/..\\..\\..\\..\\..\\..\\..\\..\\etc\\passwd",
        "//etc/passwd",
        "/etc/passwd",
        "/%00/etc/passwd",
    ],
)
def test_no_file_can_be_read(url: str, path: str) -> None:
    connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=30)
    connection.putrequest("GET", path, skip_host=False)
    connection.endheaders()
    answer = connection.getresponse()
    assert answer.status >= 400
    assert b"root:" not in answer.read()
    connection.close()


def test_it_listens_to_this_machine_only(url: str) -> None:
    port = int(url.rpartition(":")[2])
    lines = Path("/proc/net/tcp").read_text().splitlines()[1:]
    listening = [line.split()[1] for line in lines if line.split()[3] == "0A"]
    assert [a for a in listening if a.endswith(f":{port:04X}")] == [f"0100007F:{port:04X}"]


@pytest.mark.parametrize(
    ("host", "port", "message"),
    [
        ("127.0.0.1", 65536, "from 0 to 65535; found 65536"),
        ("127.0.0.1", 70000, "from 0 to 65535; found 70000"),
        ("127.0.0.1", -1, "from 0 to 65535; found -1"),
        ("192.0.2.1", 8080, "Cannot listen at 192.0.2.1"),  # an address of nobody (RFC 5737)
        ("no such host", 8080, "Cannot listen at no such host"),
    ],
)
def test_an_address_of_others_is_refused(
    session: Session, host: str, port: int, message: str
) -> None:
    from backends.viewers.web import WebView

    with pytest.raises(CdcsrError, match=message):
        WebView(session, host, port)
    session.close()


def test_updates_of_paper_take_less_than_a_core(paper: Robot) -> None:
    from backends.viewers.web import WebView

    driver = StepByStep(JacobianController(paper), paper)
    session = Session(paper, ["mujoco"], anchor(paper), [driver])
    session.drive("jacobian")
    view = WebView(session, port=0)
    session.playing, reader = True, threading.Thread(target=Page, args=(view.url,))
    reader.start()
    begun, updates = time.process_time(), 40
    for _ in range(updates):
        view.update()
        time.sleep(1 / 30)
    rate = updates / (time.process_time() - begun)
    reader.join()
    view.close()
    print(f"\n{rate:.0f} updates/s of a processor's time")
    assert rate > 25


def test_a_page_that_was_asleep_loses_time_and_a_refusal_is_a_note(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long ago the last update was, a quarter of a second passes; and nothing is drawn
    where nothing has changed."""
    from backends.viewers import web as room

    now, session = 100.0, Session(paper, ["mujoco"], anchor(paper))
    monkeypatch.setattr(room, "time", SimpleNamespace(perf_counter=lambda: now))
    room._check_address("127.0.0.1", 65535)
    view, passed, drawn = room.WebView(session, port=0), [], []
    inner, draw = session.advance, view._engines[0].draw
    monkeypatch.setattr(session, "advance", lambda *given: passed.append(given) or inner(given[0]))
    monkeypatch.setattr(
        view._engines[0], "draw", lambda *given: drawn.append(given) or draw(*given)
    )
    for later in (100.125, 100.25, 107.0):
        now = later
        view.update()
        assert len(drawn) == 1  # the first time only
    np.testing.assert_allclose([seconds for seconds, _ in passed], [0.125, 0.125, 0.25])
    assert {budget < 1 / 30 for _, budget in passed} == {True}
    view._asked.put(lambda: session.new_target(3))
    for count in (2, 2):  # what a page asks for is drawn, once
        view.update()
        assert len(drawn) == count
    session.playing, session.speed = True, 1.0
    view._asked.put(lambda: session.drive("nobody"))
    now += 8.5 * paper.time_step
    view.update()
    assert "nobody" in session.note
    assert session.steps == 8
    assert len(drawn) == 3
    _, _, slack, trail, target = drawn[-1]
    np.testing.assert_allclose(slack, session.views()[0].slack)
    np.testing.assert_array_equal(trail, [moment.tip[0] for moment in session.history])
    np.testing.assert_array_equal(target, session.target)
    assert view.num_pages == 0
    slept: list[float] = []
    monkeypatch.setattr(room, "time", SimpleNamespace(perf_counter=lambda: 7.0, sleep=slept.append))
    view.run(lambda: len(slept) == 3)
    assert slept == pytest.approx([1 / 30] * 3)
    late = SimpleNamespace(perf_counter=iter(range(100)).__next__, sleep=slept.append)
    monkeypatch.setattr(room, "time", late)  # an update takes seconds: the next follows at once
    view.run(lambda: len(slept) == 4)
    assert slept[3] == 0
    view.close()


@pytest.mark.parametrize("numbers", [PLANT, NOISES])
def test_numbers_begin_where_they_change_nothing_and_move_in_whole_steps(
    numbers: Mapping[str, ShownNumber],
) -> None:
    """Factors begin at 1 and everything else at 0; factors and amounts are not negative, and
    shares at most 1."""
    for number in numbers.values():
        factor = number.title.endswith("factor")
        assert number.start == (1 if factor else 0)
        assert number.low <= number.start <= number.high
        steps = np.array([number.start - number.low, number.high - number.low]) / number.step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert 20 <= steps[1] <= 100
        if factor:
            assert (number.low < 0.3, number.high) == (True, 4)  # from hardly any to four times
        if "share" in number.title:
            assert number.high in (0.5, 1)
        assert number.low == -number.high if "added" in number.title else number.low >= 0
        assert number.scale == (1e-3 if "[mm]" in number.title else 1)
        if "delay" in number.title:  # as far as 40, one by one
            assert (number.high, number.step) == (40, 1)
