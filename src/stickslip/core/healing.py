"""Kernels on the disk that were damaged are compiled again, with one warning, instead of ending the process.

Numba unpickles what it finds. Every kernel that is kept therefore ends with its checksum, which other readers pass
over; one that does not fit it, or cannot be unpickled, counts as missing, and is written anew.
"""

import contextlib
import hashlib
import os
import warnings

from numba.core.caching import Cache, IndexDataCacheFile

_MARK = b"\0stickslip, SHA-256:\0"
_told = False


class DamagedKernelWarning(RuntimeWarning):
    """A compiled kernel on the disk was damaged, and was compiled again."""


def _tell(path: str, problem: Exception) -> None:
    global _told
    if not _told:
        _told = True
        words = f"the compiled kernel {path} is damaged ({type(problem).__name__}): it is compiled again"
        warnings.warn(words, DamagedKernelWarning, stacklevel=2)


def _load_index(self, whole=IndexDataCacheFile._load_index):
    try:
        return whole(self)
    except OSError:
        raise
    except Exception as problem:  # whatever unpickling runs into
        _tell(self._index_path, problem)
        return {}


def _load_data(self, name, whole=IndexDataCacheFile._load_data):
    path = self._data_path(name)
    try:
        with open(path, "rb") as file:
            data = file.read()
        body, mark, digest = data.rpartition(_MARK)
        if mark and len(digest) == 32 and hashlib.sha256(body).digest() != digest:
            raise ValueError("its checksum is that of another one")
        return whole(self, name)
    except OSError:
        raise
    except Exception as problem:
        _tell(path, problem)
        raise OSError(f"{path} is damaged") from problem  # which Numba takes for a kernel that is not there


def _save(self, key, data):
    """Keep a kernel in a file that is named by what is in it, and is there before the index tells of it.

    Numba numbers its files, and writes the index first. A disk that is full in between, or another process that
    compiles the same function for other types meanwhile, would leave an index that names somebody else's kernel.
    """
    body = self._dump(data)
    digest = hashlib.sha256(body).digest()
    name = self._data_name(int.from_bytes(digest[:6]))
    with self._open_for_write(self._data_path(name)) as file:
        file.write(body + _MARK + digest)
    overloads = self._load_index()
    before, overloads[key] = overloads.get(key), name
    self._save_index(overloads)
    if before and before not in overloads.values():
        with contextlib.suppress(OSError):
            os.unlink(self._data_path(before))


def _save_overload(self, sig, data, whole=Cache.save_overload):
    """Keep a kernel if the disk lets it be kept; a run does not end for want of room for what it has compiled."""
    with contextlib.suppress(OSError):
        whole(self, sig, data)


def heal() -> None:
    """Let Numba's cache heal in this process."""
    Cache.save_overload, IndexDataCacheFile.save = _save_overload, _save
    IndexDataCacheFile._load_index, IndexDataCacheFile._load_data = _load_index, _load_data
