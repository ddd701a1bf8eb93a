"""Random damage from a seed: to bytes, tokens and values of a record."""

import json
from copy import deepcopy

import numpy as np

from tirefit.door import sealed

__all__ = ["changed_record", "damaged"]

_TOKENS = (
    b"1e308", b"-1e308", b"1e-308", b"1e9", b"1e10", b"10000000000", b"9" * 400,
    b"9" * 5000, b"-0.0", b"0", b"-1", b"nan", b"inf", b"-inf", b"true", b"null",
    b"''", b'""', b"[]", b"{}", b"[[1], [1, 2]]", b"[" * 3000, b"{" * 3000,
    b"a." * 3000, b"\x00", b"\x1b[2J", b"\x07", b"\x7f", b"\xff\xfe", b"\xc3",
    "\u202e\u0660".encode(), b"\r", b"\n\n", b"=", b"#", b"$", b",", b";", b'"',
    b"'", b"1_000", b"0x1F", b"1e", b"2026-01-01",
)  # fmt: skip
"""What no reader expects where a number or a name stands."""


def _number_or_word(content: bytes, random) -> tuple[int, int]:
    """Ends of a token of a text: letters, digits, points, signs."""
    place = int(random.integers(0, max(len(content), 1)))
    word = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.+-_"
    start = end = place
    while start > 0 and content[start - 1] in word:
        start -= 1
    while end < len(content) and content[end] in word:
        end += 1
    return start, end


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """The content with one to four errors."""
    for _ in range(int(random.integers(1, 5))):
        n = len(content)
        a, b = sorted(int(x) for x in random.integers(0, n + 1, 2))
        b = min(b, a + int(random.choice([1, 8, 200, n + 1])))
        token = _TOKENS[int(random.integers(len(_TOKENS)))]
        match int(random.integers(0, 7)):
            case 0 if n:  # one bit
                changed = bytearray(content)
                changed[a % n] ^= 1 << int(random.integers(8))
                content = bytes(changed)
            case 1:  # a span is lost
                content = content[:a] + content[b:]
            case 2:  # a span comes twice
                content = content[:b] + content[a:b] + content[b:]
            case 3:  # the end is lost
                content = content[:a]
            case 4:  # something in between
                content = content[:a] + token + content[a:]
            case _:  # another token; twice as often as the others
                start, end = _number_or_word(content, random)
                content = content[:start] + token + content[end:]
    return content


_VALUES = (
    None, True, "", "x", -1, 0, 1e308, 10**400, [], [[1.0], [1.0, 2.0]], {}, {"a": 1},
    [None], ["fx"], "magic-formula", [1.0, "1.0"],
)  # fmt: skip


def changed_record(content: bytes, random: np.random.Generator) -> bytes:
    """A JSON record with one to three values replaced, and a right checksum."""
    record = json.loads(content)
    record.pop("checksum", None)
    for _ in range(int(random.integers(1, 4))):
        place = record
        while True:
            keys = list(place) if isinstance(place, dict) else range(len(place))
            if not len(keys):
                break
            key = keys[int(random.integers(len(keys)))]
            inner = place[key]
            if isinstance(inner, dict | list) and random.random() < 0.8:
                place = inner
                continue
            value = _VALUES[int(random.integers(len(_VALUES)))]
            place[key] = deepcopy(value)  # a place for the next change
            break
    return json.dumps(sealed(record)).encode()
