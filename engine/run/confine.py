"""Confine a program to some files of the machine, for good, by Linux's Landlock: needs no rights and no other program.

    python -m jrdb_avr.engine.run.confine JSON    # {"read": [path, ...], "write": [path, ...], "run": [argument, ...]}

The program, and whatever it starts, opens and lists nothing else. It sends no signal to other processes and reads
neither their memory nor their open files or environment, also as the superuser, whose powers it gives up.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import struct
import sys
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.schema.errors import StoreError

_CREATE, _ADD, _RESTRICT = 444, 445, 446
"""Numbers of the system calls landlock_create_ruleset, _add_rule and _restrict_self, on every machine of `_CAPSET`."""
_CAPSET: Final = (
    {"x86_64": 126, "aarch64": 91, "riscv64": 91}.get(platform.machine()) if sys.maxsize > 1 << 32 else None
)
"""Number of the system call capset on this machine; None on machines that are not supported."""
_DEATH_SIGNAL, _NO_NEW_PRIVILEGES = 1, 38
_BENEATH: Final = 1

_READ: Final = 1 | 4 | 8
"""Execute, read a file, list a folder."""
_RIGHTS: Final = {1: (1 << 13) - 1, 2: 1 << 13, 3: 1 << 14, 5: 1 << 15}
"""Rights on files, by the version of Landlock since which they are known; what is not granted of them is refused."""
_OF_A_FILE: Final = 1 | 2 | 4 | 1 << 14 | 1 << 15
_SCOPED_SINCE, _SCOPED = 6, 3
"""Neither signals to other processes nor their abstract sockets."""


def check_confinable() -> None:
    """Raise StoreError where this system cannot confine a program."""
    if not _version():
        raise StoreError(
            "--isolated: this system cannot confine a process (64-bit Linux 5.13 or newer, with Landlock, on x86, "
            "ARM or RISC-V can): leave it out, and run on a machine that holds the public files alone"
        )


def confine(readable: list[str], writable: list[str]) -> None:
    """Restrict this thread and the processes that it starts to these files and folders, for good.

    Missing paths are passed over. Raises StoreError as `check_confinable`, OSError where the kernel refuses.
    """
    check_confinable()
    version = _version()
    rights = sum(right for since, right in _RIGHTS.items() if version >= since)
    scoped = (0, _SCOPED) if version >= _SCOPED_SINCE else ()
    attributes = struct.pack(f"{1 + len(scoped)}Q", rights, *scoped)
    ruleset = _call(_CREATE, attributes, ctypes.c_size_t(len(attributes)), 0)
    for paths, granted in ((readable, _READ), (writable, rights)):
        for path in filter(os.path.exists, paths):
            place = os.open(path, os.O_PATH | os.O_CLOEXEC)
            own = granted & rights & (-1 if Path(path).is_dir() else _OF_A_FILE)
            _call(_ADD, ruleset, _BENEATH, struct.pack("=Qi", own, place), 0)
            os.close(place)
    if _LIBC.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "no_new_privs is refused")
    _call(_RESTRICT, ruleset, 0)
    os.close(ruleset)
    # The three sets of capabilities, all empty, of this process.
    assert _CAPSET is not None, "checked above"
    _call(_CAPSET, struct.pack("=Ii", 0x20080522, 0), bytes(24))


_LIBC: Final = ctypes.CDLL(None, use_errno=True)


def _version() -> int:
    if platform.system() != "Linux" or _CAPSET is None:
        return 0
    return max(0, int(_LIBC.syscall(_CREATE, None, ctypes.c_size_t(0), 1)))


def _call(number: int, *values: Any) -> int:
    result = int(_LIBC.syscall(number, *values))
    if result < 0:
        raise OSError(ctypes.get_errno(), f"system call {number}: {os.strerror(ctypes.get_errno())}")
    return result


# -- what a program needs ---------------------------------------------------------------------------------------------

_SYSTEM: Final = (
    *("/usr", "/lib", "/lib64", "/bin"),
    *("/etc/ld.so.cache", "/etc/ssl", "/etc/pki", "/etc/ca-certificates", "/etc/localtime"),
    *("/etc/hosts", "/etc/resolv.conf", "/etc/nsswitch.conf", "/etc/host.conf", "/etc/gai.conf"),
    *("/dev/urandom", "/dev/random", "/dev/zero", "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system/cpu"),
)
DEVICES: Final = ("/dev/null",)


def program_files(hidden: list[Path]) -> list[str]:
    """What Python, its modules and the network need of the system's files.

    Raises StoreError where something hidden is in one of these folders.
    """
    own = Path(__file__).resolve()
    # An editable install finds the package by other means than `sys.path`.
    package = str(own.parents[2])
    certificates = [os.environ[name] for name in ("SSL_CERT_FILE", "SSL_CERT_DIR") if os.environ.get(name)]
    found = []
    places = (*_SYSTEM, *certificates, sys.prefix, sys.base_prefix, package, *filter(None, sys.path))
    for path in map(os.path.realpath, places):
        if path != "/" and not any(place.is_relative_to(path) for place in hidden):
            found.append(path)
        elif path in _SYSTEM or own.is_relative_to(path) or path in (sys.prefix, sys.base_prefix):
            raise StoreError(f"--isolated: {path} holds programs, and the store or its labels: move these elsewhere")
    return found


if __name__ == "__main__":
    program = msgspec.json.decode(sys.argv[1])
    # It ends with who started it, even killed.
    _LIBC.prctl(_DEATH_SIGNAL, signal.SIGKILL)
    confine(program["read"], program["write"])
    os.execv(program["run"][0], program["run"])  # noqa: S606
