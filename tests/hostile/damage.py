"""Random damage to the bytes and fields of files."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np

Rng = np.random.Generator
Damage = Callable[[Rng, str, bytes], bytes]
"""(source of chance, name of the file, content) → damaged content."""

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
STRANGE = (
    *(b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-0.0", b"1e30", b""),
    *(b"0x10", b"1_000", b"1,5", b"\xd9\xa3", b"--1", b"1e", b"9" * 400),
)
"""What takes the place of a number."""
BOMB = b"""<?xml version="1.0"?>
<!DOCTYPE bomb [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;&c;&c;">
<!ENTITY e "&d;&d;&d;&d;&d;&d;&d;&d;&d;&d;"><!ENTITY f "&e;&e;&e;&e;&e;&e;&e;&e;&e;&e;">
<!ENTITY g "&f;&f;&f;&f;&f;&f;&f;&f;&f;&f;"><!ENTITY h "&g;&g;&g;&g;&g;&g;&g;&g;&g;&g;">]>
<gama-local><network><description>&h;</description></network></gama-local>
"""
LONG = 20_000_000
"""Length of a long line; one in a hundred of them is five times as long."""


def flip(rng: Rng, _: str, content: bytes) -> bytes:
    """Change some bytes."""
    data = bytearray(content or b" ")
    for _ in range(int(rng.integers(1, 6))):
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
    return bytes(data)


def cut(rng: Rng, _: str, content: bytes) -> bytes:
    """Leave a piece out, or everything from some place on."""
    a, b = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:a] if rng.random() < 0.5 else content[:a] + content[b:]


def double(rng: Rng, _: str, content: bytes) -> bytes:
    """Repeat a piece."""
    a, b = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:b] + content[a:b] + content[b:]


def numbers(rng: Rng, _: str, content: bytes) -> bytes:
    """Replace some numbers by strange ones."""
    n = NUMBER.subn(b"", content)[1]  # without an object for each, of which there may be millions
    if not n:
        return content
    chosen = set(rng.choice(n, min(3, n), replace=False).tolist())
    found = islice(NUMBER.finditer(content), max(chosen) + 1)
    data = content
    for start, end in [m.span() for i, m in enumerate(found) if i in chosen][::-1]:
        strange = STRANGE[int(rng.integers(len(STRANGE)))]
        data = data[:start] + strange + data[end:]
    return data


def scale(rng: Rng, _: str, content: bytes) -> bytes:
    """Multiply some numbers, as another unit does."""
    factor = float(rng.choice([0.3048, 1000.0, 0.001, 0.9, 1.1111, np.pi / 200, -1.0]))
    part = rng.uniform(0.02, 1.0)

    def scaled(m: re.Match[bytes]) -> bytes:
        if rng.random() > part or len(m.group()) > 30:
            return m.group()
        return repr(float(m.group()) * factor).encode()

    return NUMBER.sub(scaled, content)


def columns(rng: Rng, name: str, content: bytes) -> bytes:
    """Exchange two columns of a table under the same header, or cells of a row."""
    if not name.endswith(".csv"):
        return flip(rng, name, content)
    lines = [line.split(b",") for line in content.split(b"\n")]
    n = len(lines[0])
    if n < 2:
        return content
    a, b = rng.choice(n, 2, replace=False).tolist()
    rows = range(1, len(lines))
    if rng.random() < 0.5 and len(lines) > 2:
        rows = range(k := int(rng.integers(1, len(lines))), k + 1)
    for i in rows:
        if len(lines[i]) == n:
            lines[i][a], lines[i][b] = lines[i][b], lines[i][a]
    return b"\n".join(b",".join(line) for line in lines)


def lines(rng: Rng, _: str, content: bytes) -> bytes:
    """Leave lines out, repeat them, or put them in another order."""
    every = content.split(b"\n")
    way = rng.integers(3)
    if way == 0:
        keep = rng.random(len(every)) > 0.2
        return b"\n".join(line for line, k in zip(every, keep, strict=True) if k)
    if way == 1:
        k = int(rng.integers(len(every)))
        return b"\n".join([*every[:k], every[k], *every[k:]])
    return b"\n".join([every[0], *(every[1:][i] for i in rng.permutation(len(every) - 1))])


def nest(rng: Rng, name: str, content: bytes) -> bytes:
    """Put something nested deeply at a random place, or at the start."""
    depth = int(rng.choice([50, 5000, 200_000]))
    if name.endswith(".gkf"):
        return content.replace(b"<network", b"<a>" * depth + b"<network", 1)
    if name.endswith(".xml"):
        place = content.find(b">", int(rng.integers(len(content) + 1))) + 1
        return content[:place] + b"<a>" * depth + content[place:]
    if name.endswith(".toml"):
        return content + b"\nx = " + b"[" * depth
    if name.endswith((".json", ".opf", ".gltf")):
        place = content.find(b":", int(rng.integers(len(content) + 1))) + 1
        return content[:place] + b"[" * depth + content[place:]
    if name.endswith(".jsonl"):
        return b"[" * depth + b"\n" + content
    return content + b'"' * depth


def bomb(rng: Rng, name: str, content: bytes) -> bytes:
    """Put entities that grow in XML; strange quotes elsewhere."""
    if name.endswith((".gkf", ".xml", ".gvx")):
        return BOMB
    place = int(rng.integers(len(content) + 1))
    return content[:place] + b'"' + content[place:]


def long_line(rng: Rng, _: str, content: bytes) -> bytes:
    """Append a very long line."""
    n = LONG * (5 if rng.random() < 0.01 else 1)
    return content + b"\n" + (b"1," if rng.random() < 0.5 else b"x") * (n // 2)


def paths(rng: Rng, name: str, content: bytes) -> bytes:
    """Name files outside the folder."""
    if not name.endswith(".toml"):
        return content.replace(b"\n", b"\r\n")
    target = rng.choice(["../../../../etc/passwd", "/etc/passwd", "../secret.csv", "./a/../b.csv"])
    return content + f'\n[files]\npoints = "{target}"\n'.encode()


DAMAGES: tuple[Damage, ...] = (
    *(flip, cut, double, numbers, numbers, scale, columns, columns, lines, nest, bomb),
    *(long_line, paths),
)
"""Each as often as it stands here."""


QUICK: tuple[Damage, ...] = tuple(d for d in DAMAGES if d is not long_line)
"""Those that leave files short."""


def damaged(
    rng: Rng, files: dict[str, bytes], folder: Path, damages: tuple[Damage, ...] = DAMAGES
) -> str:
    """Write files of which one is damaged, once or twice; return what was done.

    Args:
        rng: source of chance.
        files: contents by name.
        folder: where they are written.
        damages: what may be done to them.
    """
    folder.mkdir(parents=True)
    name = str(rng.choice(sorted(n for n in files if files[n])))
    content, done = files[name], []
    for _ in range(1 + int(rng.random() < 0.3)):
        damage = damages[int(rng.integers(len(damages)))]
        content = damage(rng, name, content)
        done.append(damage.__name__)
    for other, data in files.items():
        (folder / other).write_bytes(content if other == name else data)
    if name.endswith(".csv") and rng.random() < 0.05:
        (folder / name).unlink()
        (folder / name).symlink_to("/etc/passwd")
        done.append("link")
    return f"{name}: {', '.join(done)}"
