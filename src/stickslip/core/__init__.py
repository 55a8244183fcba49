"""Compiled kernels and the values that they work on: numpy, numba and math only.

Numba's disk cache does not notice that an imported law has changed. Before any kernel is decorated, the cache is
therefore pointed to a folder named by a hash of these sources, unless the user chose one with NUMBA_CACHE_DIR.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
from pathlib import Path

import numba

from .healing import heal

_SHARED = "STICKSLIP_KERNELS"


def _kernel_cache() -> str:
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py")))
    name = hashlib.sha256(sources + numba.__version__.encode()).hexdigest()[:16]
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "stickslip" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return str(folder)
    except OSError:
        pass
    return _for_this_process()


def _for_this_process() -> str:
    """A folder that goes away with the process; those that it starts find it, too."""
    folder = os.environ.get(_SHARED)
    if not (folder and os.access(folder, os.W_OK)):
        folder = os.environ[_SHARED] = tempfile.mkdtemp(prefix="stickslip-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = _kernel_cache()
heal()
