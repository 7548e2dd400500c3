"""The Rerun viewer and a recording inside a page. The page opens from a file and needs no network.

The viewer is a script and its WebAssembly, both contained in the installed SDK. The SDK's own server delivers them; it
listens on localhost only and is stopped afterwards. A browser does not let a page that was opened from a file load other
files. Both are therefore packed into the page (gzip, base64) and unpacked when the reader opens the replay; until then
the page displays as fast as one without a viewer. The viewer receives the recording as bytes through a channel.
"""

from __future__ import annotations

import base64
import gzip
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket

VIEWER_POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; "
    "script-src 'unsafe-inline' 'wasm-unsafe-eval'; worker-src blob:; media-src blob:; connect-src data: blob:"
)
"""Content security policy: scripts in the page may run, and the browser refuses every network access."""
START_TIMEOUT_S = 30.0
"""Time within which the viewer's server must answer, on a machine with other work."""
COMPRESSION = 6
"""Level of gzip: 9 takes three times as long and saves one per cent."""

VIEWER_PLACE = """<div class="screen" id="replay">
<style>
#replay button { font: inherit; padding: .5rem 1rem; border: 1px solid var(--rule); background: var(--wash); cursor: pointer; }
#replay canvas { display: block; width: 100%; height: min(80vh, 46rem); background: #0d1011; }
@media (min-width: 60rem) { #replay.open { width: min(94vw, 90rem); margin-left: calc(50% - min(47vw, 45rem)); } }
</style>
<p><button type="button" id="replay-start">Open the replay</button></p>
<p class="key" id="replay-status">The viewer is part of this page. It starts in a few seconds and needs WebGL or WebGPU.</p>
</div>"""
"""The place of the viewer in the page."""

SCRIPT = """<script>
(() => {
  const start = document.getElementById("replay-start"), status = document.getElementById("replay-status");
  const packed = (id) => Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
  const unpacked = (id) =>
    new Response(new Blob([packed(id)]).stream().pipeThrough(new DecompressionStream("gzip")));
  start.addEventListener("click", async () => {
    start.disabled = true;
    // The viewer would report its start to its makers and ask for a newer version. It receives an empty answer instead.
    window.fetch = async () => new Response(null, { status: 204 });
    status.textContent = "Unpacking the viewer…";
    try {
      const script = document.createElement("script");
      script.textContent = await unpacked("viewer-script").text();
      document.head.append(script);
      await wasm_bindgen({ module_or_path: await unpacked("viewer-code").arrayBuffer() });
      const canvas = document.createElement("canvas");
      canvas.id = "replay-canvas";
      document.getElementById("replay").append(canvas);
      document.getElementById("replay").classList.add("open");
      const viewer = new wasm_bindgen.WebHandle({
        url: [], hide_welcome_screen: true, persist: false, enable_history: false, notebook: false, theme: "dark",
        panel_state_overrides: { top: "Hidden", blueprint: "Hidden", selection: "Hidden" },
      });
      await viewer.start(canvas);
      viewer.open_channel("throw", "throw");
      viewer.send_rrd_to_channel("throw", packed("viewer-recording"));
      viewer.close_channel("throw");
      start.remove();
      status.textContent = "";
      document.getElementById("replay").dataset.state = "started";
    } catch (error) {
      status.textContent = "The replay could not be started: " + error;
    }
  });
})();
</script>"""


def viewer_html(recording: Path) -> str:
    """The viewer, the recording and the starting script, for the end of a page that contains VIEWER_PLACE.

    Raises OSError if the recording cannot be read or the installed SDK contains no web viewer.
    """
    script, code = viewer_files()
    return "\n".join(
        [
            _packed("viewer-script", gzip.compress(script, COMPRESSION, mtime=0)),
            _packed("viewer-code", _compressed(code)),
            _packed("viewer-recording", recording.read_bytes()),
            SCRIPT,
        ]
    )


@lru_cache(maxsize=1)
def viewer_files() -> tuple[bytes, bytes]:
    """The web viewer of the installed SDK: its script and its WebAssembly. Raises OSError if the SDK has none."""
    with _server() as address:
        script, code = _fetched(f"{address}/re_viewer.js"), _fetched(f"{address}/re_viewer_bg.wasm")
    if not code.startswith(b"\0asm"):
        raise OSError("the installed rerun-sdk has no web viewer; install rerun-sdk from its wheel, which contains one")
    return script, code


@lru_cache(maxsize=1)
def _compressed(code: bytes) -> bytes:
    """The compressed code; compression takes seconds and runs once for all pages of a process."""
    return gzip.compress(code, COMPRESSION, mtime=0)


@contextmanager
def _server() -> Iterator[str]:
    """The address of a server of the viewer that listens on localhost only."""
    ports = _free_port(), _free_port()
    # Without a file the server waits for a program to connect; none does, and the server is stopped after two requests.
    command = [sys.executable, "-m", "rerun", "--serve-web", "--bind", "127.0.0.1"]
    command += ["--web-viewer-port", str(ports[0]), "--port", str(ports[1])]
    quiet = {**os.environ, "RUST_LOG": "off", "DO_NOT_TRACK": "1"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=quiet) as server:
        try:
            _wait_for(server, ports[0])
            yield f"http://127.0.0.1:{ports[0]}"
        finally:
            server.terminate()


def _free_port() -> int:
    with socket(AF_INET, SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_for(server: subprocess.Popen[bytes], port: int) -> None:
    """Raises OSError if nothing answers on the port within START_TIMEOUT_S."""
    until = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < until and server.poll() is None:
        with socket(AF_INET, SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise OSError(
        f"the viewer of rerun-sdk did not start within {START_TIMEOUT_S:g} s, so the page cannot contain it; "
        "write the page without the replay"
    )


def _fetched(address: str) -> bytes:
    # Without the proxies of the environment, which do not serve localhost.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(address, timeout=START_TIMEOUT_S) as answer:
            return bytes(answer.read())
    except urllib.error.URLError as error:
        raise OSError(f"the viewer of rerun-sdk could not be read from {address} ({error.reason})") from error


def _packed(name: str, data: bytes) -> str:
    """Bytes as text that the browser neither executes nor displays."""
    return f'<script type="text/plain" id="{name}">{base64.b64encode(data).decode("ascii")}</script>'
