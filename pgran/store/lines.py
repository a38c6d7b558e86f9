"""Text files line by line, with the number of the line that a message is about."""

from pgran.errors import FileError

LONGEST_LINE = 2**16  # bytes


def is_number(word):
    """Return whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


class Lines:
    """The lines of a text file one by one, none longer than a bound."""

    def __init__(self, path, stream):
        self.path, self._stream, self.number = path, stream, 0
        self.ended = True  # whether the present line has its end

    def refuse(self, why, number=None):
        """Raise a FileError about a line, the present one unless another is named."""
        raise FileError(f"{self.path}:{number or max(self.number, 1)}: {why}")

    def next(self):
        """Return the next line without its end, or None after the last one."""
        raw = self._stream.readline(LONGEST_LINE + 1)
        if not raw:
            return None
        self.number += 1
        self.ended = raw.endswith(b"\n")
        try:  # editors may put a mark in front of a file
            line = raw.decode("utf-8-sig" if self.number == 1 else "utf-8")
        except UnicodeDecodeError:
            line = "\0"
        if len(raw) > LONGEST_LINE or "\0" in line:
            packed = raw.startswith(b"\x1f\x8b") and self.number == 1
            self.refuse("is compressed: unpack it first" if packed else "is no line of text")
        return line.rstrip("\r\n")

    def next_content(self):
        """Return the next line that holds more than a comment, without its comment, or None."""
        while (line := self.next()) is not None:
            if content := line.partition("#")[0].strip():
                return content
        return None

    def need(self, what):
        """Return the next line, in which something is expected."""
        line = self.next()
        if line is None or not self.ended:
            self.refuse(f"the file ends here, within its {what}: was it cut?")
        return line

    def last(self, start):
        """Return how many lines begin with a text, and go back to the last of them."""
        before, count = 0, 0
        while (line := self.next()) is not None:
            if line.startswith(start):
                place, number, count = before, self.number - 1, count + 1
            before = self._stream.tell()
        if count:
            self._stream.seek(place)
            self.number = number
        return count
