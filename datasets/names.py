"""Names are data: make one safe for the terminal and for pictures. In HTML, the templates escape what they insert.

``scripts/shared/output.py`` has the one function that prints; whatever a figure writes that is not a word of the
program goes through :func:`make_drawable`.

The name of a file may hold line breaks, escape sequences that recolour or clear a terminal, bytes that are not UTF-8,
and dollar signs, which matplotlib takes for mathematics.
"""


def make_printable(text: object) -> str:
    """Return a text for the terminal, on one line: a letter that is not printable is escaped, as ``\\x1b``."""
    return "".join(letter if letter.isprintable() else _escape_letter(letter) for letter in str(text))


def make_drawable(name: object) -> str:
    """Return a name for matplotlib, which takes what stands between two dollar signs for mathematics."""
    return make_printable(name).replace("$", r"\$")


def _escape_letter(letter: str) -> str:
    """Return a letter that cannot be printed as an escape sequence; a surrogate as the byte that it stands for."""
    code = ord(letter)
    if 0xDC80 <= code <= 0xDCFF:  # a byte that is not UTF-8, as Python keeps it in names of files
        return f"\\x{code - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode()
