"""Progress with the time that is left, on the standard error of rank 0."""

import sys
import time


class Progress:
    """Counts finished items, `what` in the plural, on rank 0; close with `with`.

    The style is `bar`, through tqdm, `lines`, one every ten seconds, `none`, or `auto`, which is a
    bar on a terminal.
    """

    seconds_between_lines = 10.0

    def __init__(self, total, what, style="auto"):
        """Start the clock."""
        self.total, self.what, self.done = total, what, 0
        self.last_time, self.last_done, self.bar = time.monotonic(), 0, None
        if style == "auto":
            style = "bar" if sys.stderr.isatty() else "lines"
        self.lines = style == "lines"
        if style == "bar":
            try:
                from tqdm import tqdm

                self.bar = tqdm(total=total, unit=f" {what}", leave=False)
            except ImportError:
                self.lines = True

    def __enter__(self):
        """Return the counter."""
        return self

    def __exit__(self, *error):
        """Remove the bar."""
        if self.bar is not None:
            self.bar.close()

    def advance(self, count):
        """Note that `count` more items are done."""
        self.done += count
        if self.bar is not None:
            self.bar.update(count)
        now = time.monotonic()
        if self.lines and count and now - self.last_time >= self.seconds_between_lines:
            # by the pace since the last line: what an earlier run had finished came at once
            left = (now - self.last_time) * (self.total - self.done) / (self.done - self.last_done)
            self.last_time, self.last_done = now, self.done
            text = f"{self.done} of {self.total} {self.what}, about {_duration(left)} left"
            print(f"pgran: {text}", file=sys.stderr, flush=True)


def _duration(seconds):
    """Return a time in the largest unit that suits it."""
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
