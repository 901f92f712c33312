"""MuJoCo Studio's web viewer, bound to one address and closed to the pages of other sites.

Studio binds every interface and answers every Host and Origin, and has no option for either: three of its functions
are replaced while the viewer runs. If another version lacks one of them, nothing is served.
"""

from __future__ import annotations

import errno
import ipaddress
import logging
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any, Protocol
from urllib.parse import urlsplit

# pyright: reportAttributeAccessIssue=false
import mujoco
from mujoco.studio import launch_thread, messages, ux, viewer_protocol, web_viewer
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import web_server

from kickbench.errors import KickbenchError

_PORTS = 20
"""Ports that are tried, from the wished one on."""
_PATIENCE = 30.0
"""How long Studio may take to begin to serve, s."""


class Panel(Protocol):
    """What a viewer shows; all of it is called in the thread that called `show`."""

    def prepare(self, viewer: Any) -> None:
        """Called once, before the first frame, with Studio's `WebViewer`."""

    def update(self, viewer: Any) -> None:
        """Called before every frame that a browser shows: sets `viewer.data`."""

    def draw(self, imgui: Any) -> None:
        """Called for every frame that a browser shows: builds windows with the bindings of Dear ImGui."""


class _Plugin:
    """A panel as Studio calls it."""

    def __init__(self, panel: Panel) -> None:
        self._panel = panel

    @messages.handler
    def _on_init(self, event: viewer_protocol.ViewerInitEvent) -> None:
        self._viewer = event.viewer
        ux.setup_theme(ux.GuiTheme.DARK)
        self._panel.prepare(event.viewer)

    @messages.handler
    def _on_update(self, event: messages.UpdateEvent) -> None:
        self._panel.update(self._viewer)

    @messages.handler
    def _on_gui(self, event: messages.BuildGuiEvent) -> None:
        self._panel.draw(imgui)


def listen(host: str, port: int) -> socket.socket:
    """Opens a listening socket on a port, or on the next one that is free.

    Args:
        host: Name or address of an interface.
        port: The wished port; 0: any.

    Raises:
        KickbenchError: The host is none of this machine's, or none of 20 ports is free.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for candidate in range(port, min(port + _PORTS, 2**16)):
        try:
            return socket.create_server((host, candidate), family=family)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise KickbenchError(f"--host {host} --port {candidate}: {error.strerror or error}") from None
    raise KickbenchError(f"--port {port}: this port and the {_PORTS - 1} after it are taken")


def refusal(headers: Any, names: Collection[str] | None) -> str | None:
    """Why a request is refused; None: it is not.

    A page of another site can make a browser send requests here: under a name of its own that it has pointed at this
    machine (DNS rebinding: the Host is foreign), or across sites (the Origin is foreign).

    Args:
        headers: Headers of the request, with `get_all(name)`.
        names: Hosts besides addresses that may be asked for; None: only this machine's loopback names and addresses.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _is_own(hosts[0], names):
        return f"foreign Host: {', '.join(hosts)}"
    if any(origin.lower().partition("://")[2] != hosts[0].lower() for origin in origins):
        return f"foreign Origin: {', '.join(origins)}"
    return None


def _is_own(host: str, names: Collection[str] | None) -> bool:
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name == "localhost" or name in (names or ()):
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return False
    # No name server can point an address elsewhere.
    return names is not None or address.is_loopback


class _Guard:
    """Stands in for `websockets.serve`: refuses what is foreign before Studio sees it."""

    def __init__(self, serve: Callable[..., Any], names: Collection[str] | None) -> None:
        self._serve, self._names, self.serving = serve, names, threading.Event()

    def __call__(self, handler: Any, *, process_request: Callable[..., Any], **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            reason = refusal(request.headers, self._names)
            if reason is None and request.path.startswith("/drop"):
                reason = "models are not taken"
            if reason is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            return process_request(connection, request)

        self.serving.set()
        return self._serve(handler, process_request=check, **options)


_REPLACED = ((web_server, "serve"), (web_server, "bind_public_socket"), (web_viewer, "_print_url_banner"))


def _check_studio() -> None:
    for module, name in _REPLACED:
        if not hasattr(module, name):
            found = f"MuJoCo {mujoco.__version__} has no {module.__name__}.{name}"
            raise KickbenchError(f"{found}, so its viewer cannot be guarded: pip install 'mujoco==4.0.*'")


@contextmanager
def _replaced(*functions: Callable[..., Any]) -> Iterator[None]:
    before = [getattr(module, name) for module, name in _REPLACED]
    try:
        for (module, name), function in zip(_REPLACED, functions, strict=True):
            setattr(module, name, function)
        yield
    finally:
        for (module, name), function in zip(_REPLACED, before, strict=True):
            setattr(module, name, function)


def show(model: mujoco.MjModel, panel: Panel, title: str, host: str, port: int, browser: bool | None) -> None:
    """Serves a model to browsers until Ctrl-C; prints the address.

    Args:
        model: What is shown.
        panel: Its state and controls.
        title: Title of the page.
        host: Interface to bind.
        port: Port; if it is taken, one of the next.
        browser: Whether to open a browser; None: where there is one.

    Raises:
        KickbenchError: There is no port, no browser though one is asked for, or Studio cannot be guarded.
    """
    _check_studio()
    opened = _find_browser(required=browser is True) if browser is not False else None
    server = listen(host, port)
    address, taken = server.getsockname()[:2]
    local = ipaddress.ip_address(address).is_loopback
    names = None if local else {host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}
    guard = _Guard(web_server.serve, names)
    url = _url(address, taken)
    logging.getLogger("WebServer").setLevel(logging.WARNING)
    with server, _replaced(guard, lambda host, port: server, lambda host, port: None):
        config = viewer_protocol.ViewerConfig(title=title, gfx="web", http_port=taken)
        endpoint, _ = launch_thread.make_thread_endpoints()
        viewer = web_viewer.WebViewer(config, endpoint, model=model, plugins=[_Plugin(panel)])
        try:
            if not guard.serving.wait(_PATIENCE):
                raise KickbenchError(f"MuJoCo {mujoco.__version__}: its web viewer does not begin to serve")
            _announce(url, port, taken, local, opened)
            viewer_protocol.run_viewer_loop(viewer)
        except KeyboardInterrupt:
            print("\nstopped", flush=True)
        finally:
            viewer.close()


def _url(address: str, port: int) -> str:
    if ipaddress.ip_address(address).is_unspecified:
        address = socket.gethostname()
    return f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/"


def _find_browser(*, required: bool) -> webbrowser.BaseBrowser | None:
    """A browser with a window; None: there is none."""
    has_screen = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    try:
        if has_screen:
            return webbrowser.get()
    except webbrowser.Error:
        pass
    if required:
        raise KickbenchError("--browser: no browser was found here; --no-browser serves the page without one")
    return None


def _announce(url: str, wished: int, port: int, local: bool, browser: webbrowser.BaseBrowser | None) -> None:
    if wished and port != wished:
        print(f"port {wished} is taken: {port} is used")
    if not local:
        print(
            f"warning: everyone who reaches port {port} of this machine sees this page and controls it",
            file=sys.stderr,
        )
    print(f"{url}  (Ctrl-C ends it)", flush=True)
    if browser is None:
        far = f"; from another machine: ssh -L {port}:127.0.0.1:{port} HOST" if local else ""
        print(f"open this address in a browser{far}", flush=True)
    else:
        threading.Thread(target=browser.open, args=(url,), daemon=True).start()
