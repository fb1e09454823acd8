"""Recordings and reports for download: files of one kind in one folder, nothing outside of it."""

from __future__ import annotations

import gzip
import os
import re
import stat
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

_REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; style-src 'unsafe-inline';"
    " img-src data: blob:; font-src data:; connect-src data: blob:; frame-ancestors 'none'; base-uri 'none';"
    " form-action 'none'; sandbox allow-scripts allow-popups"
)
"""A report is a page of its own origin: it draws with its own scripts, and reaches nothing of this server."""
_GZIP_LEVEL = 5
"""5.2 MB become 1.7 MB in a tenth of a second of a thread; higher levels gain little."""
_LIBRARY = re.compile(rb'<script src="(plotly-[\w.-]+\.js)"></script>')


class Downloads(StaticFiles):
    """The files below ``folder`` whose names end with ``suffix``; links that leave it are not followed."""

    def __init__(self, folder: Path, suffix: str) -> None:
        super().__init__(directory=folder, check_dir=False)
        self._suffix = suffix

    async def check_config(self) -> None:
        """Accept a missing folder: it appears with the first recording, and until then nothing is found."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return the file at ``path``. Raises: HTTPException (404)."""
        if not path.endswith(self._suffix):
            raise HTTPException(404)
        try:
            response = await super().get_response(path, scope)
            if self._suffix == ".html":
                response = await run_in_threadpool(self._whole, path, response, _takes_gzip(scope))
        except OSError as error:
            raise HTTPException(404) from error
        except HTTPException as error:  # 401 for a file that this process may not read: no token would help
            raise HTTPException(404 if error.status_code == 401 else error.status_code) from error
        response.headers["Cache-Control"] = "no-cache"
        if self._suffix == ".html":
            response.headers["Content-Security-Policy"] = _REPORT_POLICY
        else:
            response.headers.setdefault("Content-Disposition", f'attachment; filename="{_plain(path)}"')
        return response

    def _whole(self, path: str, response: Response, is_zipped: bool) -> Response:
        """The page with its drawing library inside, because it may fetch nothing; any other response as it is."""
        if not isinstance(response, FileResponse):
            return response
        page = Path(response.path).read_bytes()
        wanted = _LIBRARY.search(page)
        if wanted is None:
            return response
        library, said = self.lookup_path(os.path.join(os.path.dirname(path), wanted[1].decode()))
        if said is None or not stat.S_ISREG(said.st_mode):
            return response
        script = b"<script>%s</script>" % Path(library).read_bytes()
        kept = {name: response.headers[name] for name in ("etag", "last-modified") if name in response.headers}
        whole = page[: wanted.start()] + script + page[wanted.end() :]
        if not is_zipped:
            return HTMLResponse(whole, headers={**kept, "Vary": "Accept-Encoding"})
        zipped = {**kept, "Vary": "Accept-Encoding", "Content-Encoding": "gzip"}
        return HTMLResponse(gzip.compress(whole, _GZIP_LEVEL, mtime=0), headers=zipped)


def _takes_gzip(scope: Scope) -> bool:
    return "gzip" in Headers(scope=scope).get("accept-encoding", "")


def _plain(path: str) -> str:
    """The file's name for a header: ASCII without quotation marks."""
    name = os.path.basename(path)
    return "".join(one if one.isascii() and one.isprintable() and one not in '"\\' else "_" for one in name)
