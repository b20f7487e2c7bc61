"""The live view: a web page that shows a session and steers it. Needs the extra `view`.

The server's threads never touch the session. What a page asks for waits in a queue until the loop
takes it up, between two updates.
"""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

import numpy as np
import viser  # pyright: ignore[reportMissingImports] - it is an extra

from backends.viewers.controls import Controls
from backends.viewers.scene import EngineScene, look_at
from backends.viewers.session import Session
from cdcsr.errors import CdcsrError
from cdcsr.simulation.engines import engine_title

UPDATES = 30.0
"""The number of updates that the loop aims at, in [1/s]."""
_BUDGET = 0.02
"""How long the engines may take in one update, in [s]; an engine that is slower loses time instead
of letting the page wait."""


class LocalServer(viser.ViserServer):
    """A server that never opens a tunnel to the world, whatever a page asks for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


class WebView:
    """A page that shows a session.

    Args:
        session: only this object's thread may use it from now on.
        host: the address to listen at.
        port: the first port to try; the next free one is taken, 0 is any.

    Attributes:
        url: where the page is.

    Raises:
        CdcsrError: this machine cannot listen there.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = 8080) -> None:
        _check_address(host, port)
        self._session, self._asked = session, SimpleQueue[Callable[[], None]]()
        # A page that sends nonsense loses its connection; the terminal need not fill with that.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        self._server = server = LocalServer(host, port, label="cdcsr", verbose=False)
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.url = f"http://{host}:{server.get_port()}"
        self._engines = [
            EngineScene(server, session.robot, engine_title(engine), number, session.space)
            for number, engine in enumerate(session.engines)
        ]
        self._controls = Controls(server, session, self._asked.put)
        look_at(server, session.robot, self._engines[-1])
        self._last, self._stale = time.perf_counter(), True

    @property
    def num_pages(self) -> int:
        """How many pages are open."""
        return len(self._server.get_clients())

    def update(self) -> None:
        """Do what pages asked for, let time pass, and show the outcome."""
        session = self._session
        with suppress(Empty):
            while True:
                request = self._asked.get_nowait()
                self._stale = True
                try:
                    request()
                except CdcsrError as error:
                    session.note = str(error)
        now = time.perf_counter()
        passed, self._last = min(now - self._last, 0.25), now
        changed = session.advance(passed, _BUDGET) or self._stale
        if changed:
            with self._server.atomic():
                trails = np.array([moment.tip for moment in session.history]).swapaxes(0, 1)
                for scene, view, trail in zip(self._engines, session.views(), trails, strict=True):
                    tension = view.state.cable_tension[0]
                    scene.draw(view.position, tension, view.slack, trail, session.target)
            self._stale = False
        self._controls.show(changed)

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Update until a condition holds."""
        while not until():
            begun = time.perf_counter()
            self.update()
            time.sleep(max(0.0, begun + 1 / UPDATES - time.perf_counter()))

    def close(self) -> None:
        """Stop the server and close the session's engines."""
        self._server.stop()
        self._session.close()


def _check_address(host: str, port: int) -> None:
    """Check that this machine can listen at an address; viser would wait for ever.

    Raises:
        CdcsrError: it cannot.
    """
    if not 0 <= port < 2**16:
        raise CdcsrError(f"A port is a number from 0 to {2**16 - 1}; found {port}.")
    try:
        socket.create_server((host, 0)).close()
    except OSError as error:
        raise CdcsrError(
            f"Cannot listen at {host} ({error.strerror}); 127.0.0.1 is this machine alone, "
            "0.0.0.0 all of its addresses."
        ) from None
