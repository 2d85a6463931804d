"""Names that become names of files: a sweep's, a dataset's, a profile's."""

from __future__ import annotations

from fl3d.core.errors import ConfigError

# A plan's lease has all three in its name, and 46 letters more while it is looked at; file systems end at 255 bytes.
LONGEST = 64
OTHERS = "_-."
POSSIBLE = (
    f"A name has letters, digits and {' '.join(OTHERS)}, begins with a letter or a digit, and is at most {LONGEST} "
    "bytes long"
)


def check_name(key: str, name: object) -> str:
    """A name that a file, a link in Markdown and a URL can hold as it is typed.

    Letters may be of any script; blanks, slashes, and what shells and URLs read otherwise are none.

    Args:
        key: of the config, for the error.
        name: a text, or a number that is meant as one.

    Raises:
        ConfigError: it cannot be a name; the message says what can.
    """
    is_number = isinstance(name, int | float) and not isinstance(name, bool)
    text = str(name) if isinstance(name, str) or is_number else ""
    why = _why_not(text)
    if why:
        shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
        given = f"'{_on_one_line(shown)}'" if isinstance(name, str) or is_number else repr(name)
        raise ConfigError(f"{key}: {given} {why}. {POSSIBLE}")
    return text


def _why_not(text: str) -> str:
    """What is wrong with a name; nothing where it is good."""
    if not text:
        return "is no name"
    wrong = next((letter for letter in text if not (letter.isalnum() or letter in OTHERS)), None)
    if wrong is not None:
        return f"holds {_shown(wrong)}"
    if not text[0].isalnum():
        return f"begins with '{text[0]}'"
    if len(text.encode(errors="replace")) > LONGEST:
        return f"is {len(text.encode(errors='replace'))} bytes long"
    return ""


def _on_one_line(text: str) -> str:
    """A text without what would break the line of an error, or turn its direction."""
    return "".join(letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in text)


def _shown(letter: str) -> str:
    """A letter as a person can read it."""
    if letter == " ":
        return "a blank"
    return f"'{letter}'" if letter.isprintable() else f"the letter U+{ord(letter):04X}"
