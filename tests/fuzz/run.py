"""Throw mutated files at a reader: `python tests/fuzz/run.py READER --runs N --seconds S`.

With atheris (`pip install atheris`, Linux and macOS) coverage guides the mutations; without it, or
with --plain, they are random. A finding ends the campaign: an error of another kind than the
reader's own, more than 5 seconds for one file, or more than a gigabyte of memory. Its bytes are
kept in the folder of --findings, and `--replay FILE` runs them again.

    for reader in $(python tests/fuzz/run.py --list); do
        python tests/fuzz/run.py $reader --runs 1000000 || break
    done
"""

from __future__ import annotations

import argparse
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
LONGEST = 5  # seconds for one file
MOST_MEMORY = 1024  # megabytes of the process
LARGEST = 1 << 16  # bytes of a mutated file
EVERY = 10_000  # files, a line about progress
SPLICES = (
    b"\0" * 4,
    b"\xff" * 4,
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\x80\0\0\0",
    b"9" * 20,
)


class TooLongError(BaseException):
    """A file took too long; no reader may catch this as a failure of its own."""


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reader", nargs="?")
    parser.add_argument("--list", action="store_true", help="the readers' names")
    parser.add_argument("--runs", type=int, default=0, help="files; 0 for no limit")
    parser.add_argument("--seconds", type=int, default=0, help="0 for no limit")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true", help="random mutations, without atheris")
    parser.add_argument("--findings", type=Path, default=Path("findings"))
    parser.add_argument("--replay", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.list:
        from readers import READERS

        print("\n".join(READERS))
    elif options.replay:
        from readers import READERS

        print("read" if READERS[options.reader].attempt(options.replay.read_bytes()) else "refused")
    elif options.plain or not guided(options):
        plain(options)


def guided(options: argparse.Namespace) -> bool:
    """A campaign of atheris, which ends the process; False if it is not installed."""
    try:
        import atheris
    except ImportError:
        return False
    with atheris.instrument_imports(include=["styl3r_cli", "styl3r_export", "PIL", "zipfile"]):
        from readers import READERS, SCRATCH, seeds

        good_files(options.reader)  # imports the rest: only what is imported here is watched
    reader, refused, read, begin = READERS[options.reader], 0, 0, time.process_time()

    def one(data: bytes) -> None:
        nonlocal refused, read
        if reader.attempt(data):
            read += 1
        else:
            refused += 1
        if (read + refused) % EVERY == 0:
            used = f"{time.process_time() - begin:.0f} s of processor time"
            print(f"{options.reader}: {read} read, {refused} refused, {used}", flush=True)

    options.findings.mkdir(exist_ok=True)
    limits = [f"-runs={options.runs or -1}", f"-max_total_time={options.seconds}"]
    limits += [f"-timeout={LONGEST}", f"-rss_limit_mb={MOST_MEMORY}", f"-max_len={LARGEST}"]
    limits += [f"-seed={options.seed}", f"-artifact_prefix={options.findings}/{options.reader}-"]
    grown = tempfile.mkdtemp(prefix="styl3r-fuzz-", dir=SCRATCH.parent)  # what is worth keeping
    atheris.Setup(
        [sys.argv[0], *limits, "-print_final_stats=1", grown, str(seeds(options.reader))], one
    )
    atheris.Fuzz()
    return True


def plain(options: argparse.Namespace) -> None:
    """A campaign of random mutations."""
    from readers import READERS

    reader = READERS[options.reader]
    good = good_files(options.reader)
    chance = random.Random(options.seed)
    start, runs, read = time.monotonic(), 0, 0
    while (not options.runs or runs < options.runs) and (
        not options.seconds or time.monotonic() - start < options.seconds
    ):
        data = mutated(chance.choice(good), good, chance)
        try:
            watched_alarm(LONGEST)
            read += reader.attempt(data)
            watched_alarm(0)
            memory = peak_megabytes()
            assert memory < MOST_MEMORY, f"{memory} MB"
        except (Exception, TooLongError):
            options.findings.mkdir(exist_ok=True)
            file = options.findings / f"{options.reader}-{options.seed}-{runs}"
            file.write_bytes(data)
            print(f"{options.reader}: finding after {runs} runs: {file}", file=sys.stderr)
            raise
        runs += 1
    seconds = time.monotonic() - start
    print(
        f"{options.reader}: {runs} runs in {seconds:.0f} s, {read} read, {runs - read} refused, "
        f"{peak_megabytes()} MB at most, no finding"
    )


def good_files(name: str) -> list[bytes]:
    """A reader's seeds, each of which it reads (so that whatever it imports is there, too)."""
    from readers import READERS, seeds

    good = [file.read_bytes() for file in sorted(seeds(name).iterdir())]
    for data in good:
        if not READERS[name].attempt(data):
            raise AssertionError(f"a seed of {name} is refused")
    return good


def mutated(data: bytes, others: list[bytes], chance: random.Random) -> bytes:
    """One to eight changes: bytes, bits, cuts, doubled parts, extremes, digits, splices."""
    new = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        place = chance.randrange(len(new) + 1)
        length = chance.choice((1, 2, 4, 8, chance.randrange(1, 200)))
        match chance.randrange(7):
            case 0 if place < len(new):
                new[place] = chance.randrange(256)
            case 1 if place < len(new):
                new[place] ^= 1 << chance.randrange(8)
            case 2:
                del new[place : place + length]
            case 3:
                new[place:place] = new[place : place + length] * chance.choice((1, 1, 2, 20))
            case 4:
                extreme = chance.choice(SPLICES)
                new[place : place + len(extreme)] = extreme
            case 5:
                other = chance.choice(others)
                begin = chance.randrange(len(other) + 1)
                new[place : place + length] = other[begin : begin + length]
            case 6:
                digits = [i for i, byte in enumerate(new) if 48 <= byte <= 57]
                if digits:
                    new[chance.choice(digits)] = chance.choice(b'0123456789-.eE[]{}"')
    return bytes(new[:LARGEST])


def watched_alarm(seconds: int) -> None:
    """End a file that takes longer (where the system has such alarms)."""
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _too_long)
        signal.alarm(seconds)


def _too_long(*_: object) -> None:
    raise TooLongError(f"more than {LONGEST} seconds")


def peak_megabytes() -> int:
    """The process's largest memory; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // unit


if __name__ == "__main__":
    main()
