"""Which sockets a process and its children have, as the kernel lists them."""

from pathlib import Path

LOOPBACK = "0100007F"


def listening(pid: int) -> set[str]:
    """Addresses that they listen on, TCP."""
    found = set()
    for table in ("tcp", "tcp6"):
        for words in _rows(table, _inodes(pid)):
            if words[3] == "0A":
                found.add(words[1].split(":")[0])
    return found


def receiving(pid: int, domain: int) -> set[str]:
    """Addresses of their UDP sockets on the ports that DDS takes messages on in a domain (RTPS 2.3, 9.6.1.1).

    Each participant has sockets to send from besides, on ports that the kernel chose and nobody is told of.
    """
    ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
    found = set()
    for table in ("udp", "udp6"):
        for words in _rows(table, _inodes(pid)):
            address, port = words[1].split(":")
            if int(port, 16) in ports:
                found.add(address)
    return found


def family(pid: int) -> list[int]:
    """A process and all below it."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(number for child in children for number in family(int(child)))]


def _rows(table: str, inodes: set[str]) -> list[list[str]]:
    lines = Path(f"/proc/net/{table}").read_text().splitlines()[1:]
    return [words for line in lines if (words := line.split())[9] in inodes]


def _inodes(pid: int) -> set[str]:
    inodes = set()
    for number in family(pid):
        for entry in Path(f"/proc/{number}/fd").iterdir():
            try:
                target = str(entry.readlink())
            except OSError:
                continue
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    return inodes
