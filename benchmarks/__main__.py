"""Every benchmark, each in a process of its own; what it prints goes to bench/<name>.md as well.

    python -m benchmarks [NAME ...] [--out bench]

Takes hours on two cores; name the ones you want to have it sooner.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

# The quick ones first; `mutants` is asked for by name.
BENCHMARKS = (
    "recorder", "speed", "tracker", "data_check", "faults", "touch", "tip_error", "monitor",
    "loop", "margins", "ros_link", "like",
)  # fmt: skip


def main() -> int:
    """Run them one after the other; 1 when one of them could not be run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHMARKS)}")
    parser.add_argument("--out", type=Path, default=Path("bench"))
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(BENCHMARKS))
    if unknown:
        parser.error(f"no benchmark called {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    options.out.mkdir(parents=True, exist_ok=True)
    failed = 0
    for name in options.names or BENCHMARKS:
        print(f"\n## {name}\n", flush=True)
        began = time.monotonic()
        with (options.out / f"{name}.md").open("w") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", f"benchmarks.{name}"], stdout=subprocess.PIPE, text=True
            )
            for line in process.stdout or ():
                print(line, end="", flush=True)
                file.write(line)
        if process.wait() != 0:
            failed = 1
            print(f"{name} ended with exit code {process.returncode}", file=sys.stderr)
        print(f"\n({name}: {time.monotonic() - began:.0f} s)", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
