"""Run a command that takes long, and print every few seconds how long it has run and the last line that it wrote.

    python tools/show_progress.py TITLE COMMAND [ARGUMENT ...]

Of a command that fails all that it wrote is printed. Ends with its exit status. Needs nothing but Python 3.10.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time

EVERY = 5.0  # s
_WIDTH = 70  # characters of the last line


def run(title: str, command: list[str], every: float = EVERY) -> int:
    """Return the exit status of ``command``."""
    began = time.monotonic()
    lines: list[str] = []
    print(f"{title} ...", flush=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace") as it:
        output = it.stdout
        assert output is not None
        reader = threading.Thread(target=lambda: lines.extend(output), daemon=True)
        reader.start()
        while reader.is_alive():
            reader.join(every)
            if reader.is_alive():
                last = next((line.strip() for line in reversed(lines) if line.strip()), "")
                print(f"  {time.monotonic() - began:4.0f} s  {last[:_WIDTH]}", flush=True)
        status = it.wait()
    if status:
        sys.stdout.writelines(lines)
    print(f"{title}: {'failed' if status else 'done'} after {time.monotonic() - began:.0f} s", flush=True)
    return status


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(run(sys.argv[1], sys.argv[2:]))
