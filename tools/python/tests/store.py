"""An object store on loopback with the part of S3 that scans and archives need."""

from __future__ import annotations

import contextlib
import itertools
import re
import threading
import urllib.parse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Store:
    """Objects by bucket and key, recorded requests, and requests to fail."""

    def __init__(self) -> None:
        self.objects: dict[str, bytes] = {}
        self.versions: dict[str, int] = {}
        self.uploads: dict[str, dict[int, bytes]] = {}
        self.requests: list[str] = []
        self.address = ""
        self.fails = lambda _line: False
        self.lock = threading.Lock()
        self.ids = itertools.count()

    def put(self, path: str, body: bytes) -> None:
        self.objects[path] = body
        self.versions[path] = self.versions.get(path, 0) + 1

    def environment(self) -> dict[str, str]:
        """Environment variables for a process that uses the store."""
        return {
            "AWS_ENDPOINT": self.address,
            "AWS_ALLOW_HTTP": "true",
            "AWS_ACCESS_KEY_ID": "id",
            "AWS_SECRET_ACCESS_KEY": "very-secret",
            "AWS_REGION": "here",
        }

    def answer(self, method: str, path: str, query: dict[str, str], headers, body: bytes):  # noqa: PLR0911
        """Status, headers and body."""
        tag = f'"v{self.versions.get(path)}"'
        there = self.objects.get(path)
        if method in ("PUT", "POST") and headers.get("If-None-Match") == "*" and there is not None:
            return 412, {}, b""
        if method == "PUT" and "partNumber" in query:
            self.uploads[query["uploadId"]][int(query["partNumber"])] = body
            return 200, {"ETag": '"part"'}, b""
        if method == "PUT":
            self.put(path, body)
            return 200, {"ETag": f'"v{self.versions[path]}"'}, b""
        if method == "POST" and "uploads" in query:
            name = f"upload{next(self.ids)}"
            self.uploads[name] = {}
            return 200, {}, f"<Result><Bucket>b</Bucket><Key>k</Key><UploadId>{name}</UploadId></Result>".encode()
        if method == "POST":
            self.put(path, b"".join(part for _, part in sorted(self.uploads.pop(query["uploadId"]).items())))
            return 200, {}, b'<Result><Bucket>b</Bucket><Key>k</Key><ETag>"x"</ETag></Result>'
        if method == "DELETE":
            self.uploads.pop(query["uploadId"], None)
            return 204, {}, b""
        if "list-type" in query:
            return 200, {}, self.listed(query.get("prefix", "")).encode()
        if there is None:
            return 404, {}, b""
        if headers.get("If-Match", tag) != tag:
            return 412, {}, b""
        about = {"ETag": tag, "Last-Modified": "Tue, 03 Jun 2025 10:00:00 GMT"}
        if method == "HEAD":
            return 200, {**about, "Content-Length": str(len(there))}, b""
        first, last = map(int, re.fullmatch(r"bytes=(\d+)-(\d+)", headers["Range"]).groups())
        last = min(last, len(there) - 1)
        return 206, {**about, "Content-Range": f"bytes {first}-{last}/{len(there)}"}, there[first : last + 1]

    def listed(self, prefix: str) -> str:
        keys = [path.removeprefix("/bucket/") for path in sorted(self.objects)]
        entries = "".join(
            f"<Contents><Key>{key}</Key><LastModified>2025-06-03T10:00:00.000Z</LastModified>"
            f'<ETag>"x"</ETag><Size>1</Size></Contents>'
            for key in keys
            if key.startswith(prefix) and "/" not in key[len(prefix) :]
        )
        return (
            f"<ListBucketResult><Name>bucket</Name><Prefix>{prefix}</Prefix><KeyCount>1</KeyCount>"
            f"<MaxKeys>1000</MaxKeys><IsTruncated>false</IsTruncated>{entries}</ListBucketResult>"
        )


@contextlib.contextmanager
def serving():
    """A store while it serves."""
    store = Store()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True

        def handle_any(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            path, _, text = self.path.partition("?")
            query = dict(urllib.parse.parse_qsl(text, keep_blank_values=True))
            with store.lock:
                store.requests.append(self.requestline)
                if store.fails(self.requestline):
                    status, headers, body = 403, {}, b""
                else:
                    status, headers, body = store.answer(self.command, path, query, self.headers, body)
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = handle_any  # noqa: N815

        def log_message(self, *_: object) -> None:
            pass

        def handle(self) -> None:
            with contextlib.suppress(ConnectionError):
                super().handle()

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads, server.block_on_close = True, False
    store.address = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield store
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
