"""A server of a file, or of some, on this machine."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread


class Server:
    """Serves `content` at `url`, and `others` by their paths.

    `asked` are the ranges that were asked for, and `num_sent` bytes were answered for them.

    They are said to have an `encoding`, such as gzip, where there is one.

    The connection of the next answer breaks after `breaks_after` bytes, where that is not 0.
    """

    def __init__(self, content: bytes, port: int) -> None:
        self.content, self.url = content, f"http://127.0.0.1:{port}/served.h5"
        self.breaks_after, self.num_sent, self.asked = 0, 0, list[str]()
        self.is_failing, self.gives_ranges = False, True
        self.others, self.encoding = dict[str, bytes](), ""


@contextmanager
def served(content: bytes) -> Iterator[Server]:
    http = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    server = Server(content, http.server_port)
    http.RequestHandlerClass = partial(_Handler, server)  # type: ignore[assignment]
    Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    yield server
    http.shutdown()
    http.server_close()


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, server: Server, *arguments: object) -> None:
        self.served = server
        super().__init__(*arguments)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        server, asked = self.served, self.headers["Range"] or ""
        if server.is_failing:
            self.send_error(500)
            return
        found = re.fullmatch(r"bytes=(\d+)-(\d*)", asked) if server.gives_ranges else None
        content = server.others.get(self.path, server.content)
        start, last = (int(found[1]), int(found[2] or len(content) - 1)) if found else (0, len(content))
        part = content[start : last + 1]
        self.send_response(206 if found else 200)
        self.send_header("Content-Length", str(len(part)))
        if server.encoding:
            self.send_header("Content-Encoding", server.encoding)
        if found:
            self.send_header("Content-Range", f"bytes {start}-{start + len(part) - 1}/{len(content)}")
        self.end_headers()
        server.asked.append(asked)
        sent, server.breaks_after = part[: server.breaks_after or None], 0
        server.num_sent += len(sent) if found else 0
        with suppress(ConnectionError):  # who asks has read enough
            self.wfile.write(sent)

    def log_message(self, *_: object) -> None: ...
