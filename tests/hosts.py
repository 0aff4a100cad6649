"""Several hosts on one machine: network namespaces on one switch, each with its own address."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

_CLONE_NEWNET = 0x40000000
_libc = ctypes.CDLL(None, use_errno=True)


class NotAllowed(Exception):
    """This user may not make network namespaces; str() is what the kernel said."""


def ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        raise NotAllowed(f"ip {' '.join(arguments)}: {done.stderr.strip()}")


class Host:
    """One namespace: its address, and the processes that run in it."""

    def __init__(self, switch: str, prefix: str, name: str, address: str):
        self.name = name
        self.address = address
        self._namespace = f"{prefix}-{name}"
        self._processes: list[subprocess.Popen[bytes]] = []
        ip("netns", "add", self._namespace)
        ip("link", "add", "eth0", "netns", self._namespace,
           "type", "veth", "peer", "name", name, "netns", switch)  # fmt: skip
        ip("-n", switch, "link", "set", name, "master", "switch", "up")
        ip("-n", self._namespace, "addr", "add", f"{address}/24", "dev", "eth0")
        for device in ("lo", "eth0"):
            ip("-n", self._namespace, "link", "set", device, "up")
        self._switch = switch

    def start(
        self, command: Sequence[str], environment: Mapping[str, str], log: Path
    ) -> subprocess.Popen[bytes]:
        """Run something there; its words go to `log`."""
        with log.open("ab") as file:
            process = subprocess.Popen(
                ["ip", "netns", "exec", self._namespace, *command],
                env=os.environ | dict(environment),
                stdout=file,
                stderr=file,
            )
        self._processes.append(process)
        return process

    def cut(self) -> None:
        """Nothing comes or goes any more, and nobody is told."""
        ip("-n", self._switch, "link", "set", self.name, "down")

    def restore(self) -> None:
        """As it was."""
        ip("-n", self._switch, "link", "set", self.name, "up")

    def end(self) -> None:
        """Without processes and without a namespace."""
        for process in self._processes:
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            process.wait()
        subprocess.run(["ip", "netns", "del", self._namespace], capture_output=True)


class Network:
    """A switch, and the hosts on it."""

    def __init__(self) -> None:
        self._prefix = f"mpf{os.getpid()}"
        self._switch = f"{self._prefix}-switch"
        self.hosts: dict[str, Host] = {}
        ip("netns", "add", self._switch)
        ip("-n", self._switch, "link", "add", "switch", "type", "bridge")
        ip("-n", self._switch, "link", "set", "switch", "up")

    def add(self, name: str) -> Host:
        address = f"10.213.7.{10 + len(self.hosts)}"
        self.hosts[name] = Host(self._switch, self._prefix, name, address)
        return self.hosts[name]

    def end(self) -> None:
        for host in self.hosts.values():
            host.end()
        subprocess.run(["ip", "netns", "del", self._switch], capture_output=True)

    @contextmanager
    def seen_from(self, host: Host) -> Iterator[None]:
        """This thread's sockets are that host's inside the block."""
        here = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        there = os.open(f"/run/netns/{self._prefix}-{host.name}", os.O_RDONLY)
        try:
            _enter(there)
            yield
        finally:
            _enter(here)
            os.close(here)
            os.close(there)


def _enter(namespace: int) -> None:
    if _libc.setns(namespace, _CLONE_NEWNET) != 0:
        raise NotAllowed(os.strerror(ctypes.get_errno()))


@contextmanager
def network() -> Iterator[Network]:
    """A network that is gone afterwards; raises NotAllowed."""
    made = None
    try:
        made = Network()
        yield made
    finally:
        if made is not None:
            made.end()
