"""`kickbench play`: the session and its controls, the guarded server over real sockets, and a real browser."""

from __future__ import annotations

import base64
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from kickbench.cli import main
from kickbench.errors import KickbenchError
from kickbench.view.play import Player, slider_limits

studio = pytest.importorskip("kickbench.view.studio")
websockets = pytest.importorskip("websockets.sync.client")

ROOT = Path(__file__).parents[2]
TASK = ROOT / "tasks" / "mini_home_field.yaml"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture
def player(session):
    return Player(session)


def run_to_end(player: Player) -> None:
    while not player.session.ending:
        player.step()


def test_time_passes_at_the_control_rate_times_the_speed(session, task):
    dt = task.spec.simulation.control_interval
    for speed, seconds, steps in ((1.0, 0.2, 0.2 / dt), (0.1, 0.2, 0.02 / dt)):
        session.restart()
        player = Player(session)
        player.speed = speed
        player.elapse(seconds + 1e-9)
        assert int(session.outcome.steps[0]) == round(steps)


def test_a_long_gap_is_not_made_up_for(player, task):
    player.elapse(3600.0)
    assert int(player.session.outcome.steps[0]) * task.spec.simulation.control_interval <= 0.25


def test_no_time_passes_while_paused_but_single_steps_do(player, session):
    player.paused = True
    before = session.qpos
    player.elapse(0.2)
    assert session.outcome is None
    np.testing.assert_array_equal(session.qpos, before)
    player.step()
    assert int(session.outcome.steps[0]) == 1


def test_the_end_of_an_episode_stays_in_sight_and_then_the_next_begins(player, session, task):
    for repeat, number in ((True, 0), (False, 1)):
        session.show(0)
        player.repeat = repeat
        run_to_end(player)
        last = session.qpos
        player.step()
        np.testing.assert_array_equal(session.qpos, last)
        for _ in range(round(1.0 / task.spec.simulation.control_interval)):
            player.step()
        assert (session.ending, session.number) == ("", number)
        assert not np.array_equal(session.qpos, last)


def test_successes_are_counted_on_each_side(player, session):
    for _ in range(2):
        run_to_end(player)
        session.mirror()
    assert [episodes for _, episodes in player.tallies] == [1, 1]
    successes, _ = player.tallies[0]
    session.show(0)
    run_to_end(player)
    assert player.tallies[0] == [successes + int(session.outcome.success[0]), 2]


class Gui:
    """Dear ImGui as the controls use it: presses what it is told to, and keeps every text."""

    Cond = SimpleNamespace(FirstUseEver=4)
    Key = SimpleNamespace(Space="space", S="s", R="r", N="n", M="m")

    def __init__(self, button="", key="", slider=("", 0.0), typing=False):
        self.button, self.key, self.slider, self.typing, self.texts = button, key, slider, typing, []

    def Begin(self, title, is_open):
        return True, True

    def Button(self, label):
        return bool(self.button) and label.startswith(self.button)

    def IsKeyPressed(self, key, repeat):
        return key == self.key

    def IsAnyItemActive(self):
        return self.typing

    def Checkbox(self, label, value):
        return False, value

    def SliderFloat(self, label, value, low, high, form):
        return (True, self.slider[1]) if label == self.slider[0] else (False, value)

    def BeginTable(self, name, columns):
        return True

    def TextUnformatted(self, text):
        self.texts.append(text)

    def __getattr__(self, name):
        return lambda *_: None


@pytest.fixture
def drawn(player):
    """Draws the controls of `player`, and returns their texts."""

    def draw(**actions) -> list[str]:
        gui = Gui(**actions)
        player.draw(gui)
        return gui.texts

    return draw


@pytest.mark.parametrize("way", ["button", "key"])
def test_buttons_and_keys_do_the_same(player, session, drawn, way):
    names = {"pause": "space", "next": "n", "mirror": "m", "step": "s", "reset": "r"}
    for button in ("pause", "next", "mirror", "step"):
        drawn(**{way: button if way == "button" else names[button]})
    assert (player.paused, session.number, session.mirrored) == (True, 1, True)
    assert int(session.outcome.steps[0]) == 1
    drawn(**{way: "reset" if way == "button" else "r"})
    assert session.outcome is None


def test_keys_do_nothing_while_a_number_is_typed(session, drawn):
    drawn(key="n", typing=True)
    assert session.number == 0


def test_a_slider_places_the_target_or_says_that_there_is_no_room(session, drawn):
    drawn(slider=("target y", 0.7))
    assert session.places[3] == pytest.approx(0.7)
    session.place(np.array([0.3, 0.1, 2.0, 0.7]))
    assert "no room" in " ".join(drawn(slider=("ball x", 0.0)))
    assert session.places[0] == pytest.approx(0.3)
    assert "no room" not in " ".join(drawn(slider=("ball x", 0.4)))


def test_the_window_reports_rewards_foot_and_success(player, session, drawn):
    run_to_end(player)
    texts = drawn()
    assert f"ended: {session.ending}" in " ".join(texts)
    assert f"success: {player.tallies[0][0]} of 1, mirrored 0 of 0 episodes" in texts
    for bound in session.env.task.rewards:
        assert bound.name in texts
    assert any(text.startswith("foot that touched the ball first: ") for text in texts)
    assert texts[-1] == f"{session.rewards[1].sum():+.3f}"


def test_sliders_reach_both_sides_of_a_home_field(task):
    limits = slider_limits(task)
    ball, target = task.spec.sampling.ball, task.spec.sampling.target
    assert limits[1, 0] < -ball.y[1] < ball.y[1] < limits[1, 1]
    assert limits[2, 1] > target.distance[1] * np.cos(target.angle[0])


SERVER = """
import sys, mujoco
from types import SimpleNamespace
from kickbench.view.studio import show

class Nothing:
    session = SimpleNamespace(title="test")
    def prepare(self, viewer): ...
    def update(self, viewer): ...
    def draw(self, imgui): ...

model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
show(model, Nothing(), sys.argv[1], 0, False)
"""


@contextmanager
def started(*command: str, cwd: Path | None = None):
    """Starts a viewer in a process of its own (Dear ImGui allows one), gives it, and kills it in the end."""
    process = subprocess.Popen(
        [sys.executable, *command],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def port_of(process: subprocess.Popen) -> int:
    assert process.stdout is not None
    return int(process.stdout.readline().split("/")[2].rpartition(":")[2])


@pytest.fixture(scope="module")
def port():
    with started("-c", SERVER, "127.0.0.1") as process:
        yield port_of(process)


def status_of(port: int, path: str, *headers: tuple[str, str]) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers:
        connection.putheader(name, value)
    connection.endheaders()
    return connection.getresponse().status


def test_it_listens_on_loopback_only(port):
    listening = [
        bytes.fromhex(line.split()[1].split(":")[0])[::-1]
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
        if line.split()[1].endswith(f":{port:04X}") and line.split()[3] == "0A"
    ]
    assert listening == [socket.inet_aton("127.0.0.1")]
    assert f":{port:04X} 0000" not in Path("/proc/net/tcp6").read_text()


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST", "127.0.0.1", "[::1]"])
@pytest.mark.parametrize("path", ["/", "/model"])
def test_its_own_page_is_served(port, host, path):
    assert status_of(port, path, ("Host", f"{host}:{port}")) == 200
    assert status_of(port, path, ("Host", f"{host}:{port}"), ("Origin", f"http://{host}:{port}")) == 200
    # A port that ssh forwards has another number there.
    assert status_of(port, path, ("Host", f"{host}:9999"), ("Origin", f"http://{host}:9999")) == 200


FOREIGN_HOSTS = (
    "evil.example",
    "localhost.evil.example",
    "127.0.0.1.evil.example",
    "192.168.1.5",
    "0.0.0.0",
    "[",
    "",
)


@pytest.mark.parametrize("path", ["/", "/model", "/web_client.js", "/ui", "/state"])
@pytest.mark.parametrize("host", FOREIGN_HOSTS)
def test_a_foreign_host_is_refused(port, host, path):
    assert status_of(port, path, ("Host", host)) == 403


def test_a_request_without_a_host_or_with_two_is_refused(port):
    assert status_of(port, "/") == 403
    assert status_of(port, "/", ("Host", "localhost"), ("Host", "evil.example")) == 403


@pytest.mark.parametrize("path", ["/ui", "/state", "/drop"])
@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:1", "http://127.0.0.1"])
def test_a_websocket_of_a_foreign_page_is_refused(port, path, origin):
    with pytest.raises(websockets.InvalidStatus, match="403"):
        websockets.connect(f"ws://127.0.0.1:{port}{path}", origin=origin, proxy=None)


def test_a_websocket_of_its_own_page_gets_the_state(port):
    origin = f"http://127.0.0.1:{port}"
    with websockets.connect(f"ws://127.0.0.1:{port}/state", origin=origin, proxy=None) as state:
        assert str(state.recv(timeout=30)).startswith("viewers=")


def test_models_are_not_taken_even_from_its_own_page(port):
    with pytest.raises(websockets.InvalidStatus, match="403"):
        websockets.connect(f"ws://127.0.0.1:{port}/drop", origin=f"http://127.0.0.1:{port}", proxy=None)


def test_another_interface_is_served_with_a_warning_to_addresses_and_own_names_only():
    with started("-c", SERVER, "0.0.0.0") as process:
        port = port_of(process)
        for host in ("192.168.1.5", "[fe80::1]", socket.gethostname(), "localhost"):
            assert status_of(port, "/", ("Host", f"{host}:{port}")) == 200
        assert status_of(port, "/", ("Host", "evil.example")) == 403
        assert process.stderr is not None
        assert process.stderr.readline() == (
            f"warning: everyone who reaches port {port} of this machine sees this page and controls it\n"
        )


def test_a_taken_port_leads_to_the_next_one(monkeypatch):
    with studio.listen("127.0.0.1", 0) as first:
        wished = first.getsockname()[1]
        with studio.listen("127.0.0.1", wished) as second:
            assert wished < second.getsockname()[1] < wished + 20
        monkeypatch.setattr(studio, "_PORTS", 1)
        with pytest.raises(KickbenchError, match=rf"--port {wished}: .* taken"):
            studio.listen("127.0.0.1", wished)


def test_a_host_of_another_machine_is_refused():
    with pytest.raises(KickbenchError, match=r"--host 192\.0\.2\.1"):
        studio.listen("192.0.2.1", 0)


@pytest.mark.parametrize(("module", "name"), studio._REPLACED)
def test_a_viewer_that_cannot_be_guarded_is_not_started(monkeypatch, module, name):
    monkeypatch.delattr(module, name)
    monkeypatch.setattr(studio, "listen", lambda *_: pytest.fail("it listens"))
    with pytest.raises(KickbenchError, match=rf"has no .*{name}.*pip install 'mujoco==4\.0\.\*'"):
        studio.show(mujoco.MjModel.from_xml_string("<mujoco/>"), None, "127.0.0.1", 0, False)


def complaint(capsys, *arguments: object) -> str:
    """The one line that `kickbench play` ends with."""
    assert main(["play", *map(str, arguments)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


def test_a_run_without_a_policy_is_named(run, capsys):
    assert "no policy and no checkpoint" in complaint(capsys, run.path)


def test_a_policy_of_another_robot_is_refused(trained, capsys):
    text = complaint(capsys, trained.path, "--task", ROOT / "tasks" / "k1_lite.yaml")
    assert "its policy sees" in text
    assert "the task k1_lite has" in text


def test_task_goes_with_a_run_only(capsys):
    assert "--task is for a run's policy" in complaint(capsys, TASK, "--task", TASK)


def test_a_folder_that_is_no_run_is_named(tmp_path, capsys):
    assert "not a run directory" in complaint(capsys, tmp_path)


def test_a_missing_file_is_named(tmp_path, capsys):
    assert "nowhere.yaml" in complaint(capsys, tmp_path / "nowhere.yaml")


def test_a_missing_browser_is_said_where_one_is_asked_for(monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "--no-browser serves the page" in complaint(capsys, TASK, "--browser")


def test_a_missing_viewer_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "kickbench.view.studio", None)
    assert "pip install 'mujoco==4.0.*'" in complaint(capsys, TASK)


@pytest.mark.parametrize("port", ["65536", "-1", "http"])
def test_a_port_that_is_none_is_refused(port, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["play", str(TASK), f"--port={port}"])
    assert "Invalid value for '--port': Input should be " in capsys.readouterr().err


class Tab:
    """A tab of a headless Chromium, driven by the DevTools protocol."""

    def __init__(self, url: str, profile: Path) -> None:
        flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        own = ["--remote-debugging-port=0", f"--user-data-dir={profile}", "--window-size=1280,800"]
        assert CHROMIUM
        nowhere = subprocess.DEVNULL
        self._process = subprocess.Popen([CHROMIUM, *flags, *own, url], stdout=nowhere, stderr=nowhere)
        file = profile / "DevToolsActivePort"
        wait_for(lambda: file.exists() and "\n" in file.read_text())
        self._tools = f"http://127.0.0.1:{file.read_text().split()[0]}/json"
        wait_for(lambda: self._pages())
        address = self._pages()[0]["webSocketDebuggerUrl"]
        self._connection = websockets.connect(address, max_size=None, proxy=None)
        self._socket = self._connection.__enter__()

    def _pages(self) -> list[dict]:
        with urllib.request.urlopen(self._tools) as answer:
            return [target for target in json.load(answer) if target["type"] == "page"]

    def picture(self) -> bytes:
        self._socket.send(json.dumps({"id": 1, "method": "Page.captureScreenshot"}))
        while (message := json.loads(self._socket.recv(timeout=120))).get("id") != 1:
            pass
        return base64.b64decode(message["result"]["data"])

    def close(self) -> None:
        self._connection.__exit__(None, None, None)
        self._process.terminate()
        self._process.wait()


def wait_for(condition) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.2)


def distinct(tab: Tab) -> int:
    """Distinct ones of a few pictures, once there is something to see."""
    import io

    from PIL import Image

    def colours() -> int:
        return len(Image.open(io.BytesIO(tab.picture())).convert("RGB").getcolors(2**24) or ())

    wait_for(lambda: colours() > 2000)
    pictures = set()
    for _ in range(6):
        pictures.add(tab.picture())
        time.sleep(1.0)
    return len(pictures)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_browser_sees_the_robot_move_may_come_back_and_ctrl_c_ends_it(tmp_path):
    # The folder it runs in stays empty.
    (here := tmp_path / "here").mkdir()
    command = ("-m", "kickbench", "play", str(TASK), "--no-browser", "--port", "0")
    with started(*command, cwd=here) as process:
        port = port_of(process)
        for visit in ("first", "second"):
            tab = Tab(f"http://127.0.0.1:{port}/", tmp_path / visit)
            assert distinct(tab) > 1
            tab.close()
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=180)
    assert process.returncode == 0
    assert (out.splitlines()[-1], err) == ("stopped", "")
    assert not list(here.iterdir())
