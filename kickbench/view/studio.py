"""MuJoCo Studio's web viewer, bound to one address and closed to the pages of other sites.

Studio binds every interface and answers every Host and Origin, and has no option for either: three of its
functions are replaced (Dear ImGui allows one viewer a process). If another version lacks one of them, nothing
is served.
"""

from __future__ import annotations

import errno
import ipaddress
import logging
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Collection
from contextlib import suppress
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

# pyright: reportAttributeAccessIssue=false
import mujoco
from mujoco.studio import launch_thread, messages, ux, viewer_protocol, web_viewer
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import web_server

from kickbench.errors import KickbenchError
from kickbench.view.play import Player

_PORTS = 20
"""Number of ports that are tried, from the requested one on."""
_CLOSING = 5.0
"""Longest time that closing may take after an interrupt, s."""
_PATIENCE = 30.0
"""How long Studio may take to begin to serve, s."""
_REPLACED = ((web_server, "serve"), (web_server, "bind_public_socket"), (web_viewer, "_print_url_banner"))


def show(model: mujoco.MjModel, player: Player, host: str, port: int, browser: bool | None) -> None:
    """Serves a model to browsers until Ctrl-C; prints the address.

    Args:
        model: What is shown.
        player: Its state and controls; the title of its session is that of the page.
        host: Interface to bind.
        port: Port; if it is taken, one of the next.
        browser: Whether to open a browser; None: if there is one.

    Raises:
        KickbenchError: There is no port, no browser though one is asked for, or Studio cannot be guarded.
    """
    for module, name in _REPLACED:
        if not hasattr(module, name):
            found = f"MuJoCo {mujoco.__version__} has no {module.__name__}.{name}"
            raise KickbenchError(f"{found}, so its viewer cannot be guarded: pip install 'mujoco==4.0.*'")
    opened = None if browser is False else _find_browser(required=bool(browser))
    server = listen(host, port)
    address, taken = server.getsockname()[:2]
    own = {host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}
    names = None if ipaddress.ip_address(address).is_loopback else own
    serving = _guard(server, names)
    logging.getLogger("WebServer").setLevel(logging.WARNING)
    with server:
        config = viewer_protocol.ViewerConfig(title=player.session.title, gfx="web", http_port=taken)
        endpoint, _ = launch_thread.make_thread_endpoints()
        viewer = web_viewer.WebViewer(config, endpoint, model=model, plugins=[_Plugin(player)])
        signal.signal(signal.SIGINT, _interrupt)
        try:
            if not serving.wait(_PATIENCE):
                raise KickbenchError(f"MuJoCo {mujoco.__version__}: its web viewer does not begin to serve")
            _announce(_url(address, taken), port, taken, names is None)
            if opened:
                threading.Thread(target=opened.open, args=(_url(address, taken),), daemon=True).start()
            viewer_protocol.run_viewer_loop(viewer)
        except KeyboardInterrupt:
            pass
        finally:
            viewer.close()


def _interrupt(*_: object) -> None:
    """Ends the viewer, and the process for certain: Studio may lose interrupts, or wait for a connection."""
    print("\nstopped", flush=True)
    timer = threading.Timer(_CLOSING, os._exit, (0,))
    timer.daemon = True
    timer.start()
    raise KeyboardInterrupt


class _Plugin:
    """A player as Studio calls it, always in the thread that called `show`."""

    def __init__(self, player: Player) -> None:
        self._player = player

    @messages.handler
    def _on_init(self, event: viewer_protocol.ViewerInitEvent) -> None:
        self._viewer = event.viewer
        ux.setup_theme(ux.GuiTheme.DARK)
        self._player.prepare(event.viewer)

    @messages.handler
    def _on_update(self, event: messages.UpdateEvent) -> None:
        self._player.update(self._viewer)

    @messages.handler
    def _on_gui(self, event: messages.BuildGuiEvent) -> None:
        self._player.draw(imgui)


def listen(host: str, port: int) -> socket.socket:
    """Opens a listening socket on a port, or on the next one that is free.

    Args:
        host: Name or address of an interface.
        port: The requested port; 0: any.

    Raises:
        KickbenchError: The host is not an address of this machine, or none of 20 ports is free.
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
    """Why a request is refused; None: it is accepted.

    A page of another site can make a browser send requests here: under a name of its own that it has pointed
    at this machine (DNS rebinding: the Host is foreign), or across sites (the Origin is foreign).

    Args:
        headers: Headers of the request, with `get_all(name)`.
        names: Host names that are accepted besides addresses; None: only this machine's loopback names
            and addresses.
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
        if name == "localhost" or name in (names or ()):
            return True
        # No name server can point an address elsewhere.
        return ipaddress.ip_address(name).is_loopback or names is not None
    except ValueError:  # neither a name nor an address
        return False


def _guard(server: socket.socket, names: Collection[str] | None) -> threading.Event:
    """Makes Studio serve on this socket only and refuse foreign requests; the event is set once it serves."""
    serve, serving = web_server.serve, threading.Event()

    def guarded(handler: Any, *, process_request: Any, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            reason = refusal(request.headers, names)
            if reason is None and request.path.startswith("/drop"):
                reason = "models are not taken"
            if reason is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            return process_request(connection, request)

        serving.set()
        return serve(handler, process_request=check, **options)

    for (module, name), own in zip(_REPLACED, (guarded, lambda *_: server, lambda *_: None), strict=True):
        setattr(module, name, own)
    return serving


def _url(address: str, port: int) -> str:
    if ipaddress.ip_address(address).is_unspecified:
        address = socket.gethostname()
    return f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/"


def _find_browser(*, required: bool) -> webbrowser.BaseBrowser | None:
    """A browser with a window, or None."""
    if sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        with suppress(webbrowser.Error):
            return webbrowser.get()
    if required:
        raise KickbenchError("--browser: no browser was found here; --no-browser serves the page without one")
    return None


def _announce(url: str, requested: int, port: int, local: bool) -> None:
    if requested and port != requested:
        print(f"port {requested} is taken: {port} is used")
    if not local:
        what = f"everyone who reaches port {port} of this machine sees this page and controls it"
        print(f"warning: {what}", file=sys.stderr)
    print(f"{url}  (Ctrl-C ends it)", flush=True)
    far = f"; from another machine: ssh -L {port}:127.0.0.1:{port} HOST" if local else ""
    print(f"open this address in a browser{far}", flush=True)
