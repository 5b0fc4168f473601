"""The page of a scene, and the server that shows it on the loopback interface."""

from __future__ import annotations

import base64
import html as escaping
import json
import sys
import threading
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from string import Template
from typing import Any

import meshcat

from eladapt.errors import ArgumentError
from eladapt.viewing.scene import Scene

LOOPBACK = "127.0.0.1"
PATIENCE = 10.0  # [s] for a browser that was connected to say what it wants, or to take it
MOST_CONNECTIONS = 32  # a browser opens up to six
VIEWER_CODE = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"

PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="$policy">
<title>$title</title>
<style>
body { margin: 0; font: 14px/1.5 sans-serif; color: #223 }
#pane { width: 100vw; height: 100vh; overflow: hidden }
#legend { position: absolute; left: 12px; bottom: 10px; pointer-events: none }
</style>
</head>
<body>
<div id="pane"></div>
<div id="legend"><b>$title</b>, $about<br>
<span style="color: #b35c0a">set-point</span>, <span style="color: #1f5fbf">path of the tool</span>$load</div>
<script>$code</script>
<script>
const viewer = new MeshCat.Viewer(document.getElementById("pane"));
for (const command of $commands)
  viewer.handle_command_bytearray(Uint8Array.from(atob(command), letter => letter.charCodeAt(0)));
const camera = $camera;
const place = () => {
  const distance = camera.distance * Math.max(1, innerHeight / innerWidth);
  viewer.camera.fov = camera.angle;
  viewer.camera.position.set(...camera.target.map((x, i) => x + distance * camera.towards[i]));
  viewer.controls.target.set(...camera.target);
  viewer.controls.update();
};
const placed = () => innerWidth > 0 ? place() : requestAnimationFrame(placed);
placed();  // a frame that is not yet shown has no width, and may be told of none when it is
addEventListener("resize", placed);  // a notebook's frame is narrow first
viewer.controls.addEventListener("start", () => removeEventListener("resize", placed));
$stream
</script>
</body>
</html>
""")


def filled(
    scene: Scene, camera: dict[str, Any], title: str, about: str, load: str, stream: str | None = None
) -> str:
    """The page of a scene. load: what the legend says behind the estimated load; nothing of it if empty.
    ``stream`` is the address of the websocket from which it goes on, if any."""
    return PAGE.substitute(
        policy=POLICY if stream is None else f"{POLICY}; connect-src {stream}",
        title=escaping.escape(title),
        about=escaping.escape(about),
        load=load and f', <span style="color: #2f7a46">load as estimated</span>{load}',
        code=VIEWER_CODE.read_text(encoding="utf-8"),
        commands=json.dumps([base64.b64encode(command).decode("ascii") for command in scene.commands]),
        camera=json.dumps(camera),
        stream="" if stream is None else f'viewer.connect("{stream}");',
    )


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = PATIENCE

    def do_GET(self) -> None:
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if self.path != "/" or host not in (LOOPBACK, "localhost"):  # another name: a page of somebody else
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.page)))
        self.end_headers()
        self.wfile.write(self.server.page)

    def log_message(self, format: str, *_: Any) -> None:
        """Nothing: the user's terminal is the user's."""


class PageServer(ThreadingTCPServer):
    """Serves one page on the loopback interface, in threads that end with the process.

    At most `MOST_CONNECTIONS` at a time: further ones are closed. A browser that hangs up, or says nothing
    for `PATIENCE`, is no error.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, page: str, port: int):
        self.page = page.encode()
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as reason:
            raise ArgumentError(f"port {port}: nothing can be served there: {reason}") from reason
        self.thread = threading.Thread(target=self.serve_forever, daemon=True)
        self.thread.start()

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """As `ThreadingTCPServer`, but for a browser that is gone."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)
