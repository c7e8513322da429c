"""Docstrings open with a plain sentence: what the thing is or does, in at most 25 words.

A first sentence may not start with a pronoun or with "What", "Of" or "Where", and it ends with a period. The code can
be checked file by file: ``python tests/test_docstrings.py plr_jax/eikonal`` prints what is wrong there.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
OPENERS = re.compile(
    r"(what|of|where|who(m|se)?|which|th(e|o)se|th(at|is)|such|its?|they|them|their|s?he|we|our|your?|ones?|another|each|both"
    r"|some\w*|all|any(one|thing)?|none|nothing|every\w*|the (same|others?))\b(?!-)",
    re.IGNORECASE,
)
MAX_WORDS = 25
EXCEPTIONS: set[str] = set()  # "file:name" of a docstring; at most ten


def complaints(path: Path) -> Iterator[tuple[str, str]]:
    """The name and the fault of each docstring of a file that breaks a rule."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        text = ast.get_docstring(node)
        if text is None:
            continue
        name = getattr(node, "name", "module")
        paragraph = " ".join(text.split("\n\n")[0].split())
        sentence = re.split(r"(?<=[.!?])\s+(?=[A-Z`])", re.sub(r"\b(e\.g|i\.e|cf|vs)\.", r"\1", paragraph))[0]
        words = sentence.split()
        if OPENERS.match(sentence):
            yield name, f'starts with "{words[0]}": {sentence}'
        if len(words) > MAX_WORDS:
            yield name, f"has {len(words)} words, at most {MAX_WORDS} are allowed: {sentence}"
        if not sentence.endswith("."):
            yield name, f"does not end with a period: {sentence}"


def test_every_first_sentence_of_a_docstring_is_plain():
    assert len(EXCEPTIONS) <= 10
    faults = [
        f"{path.relative_to(ROOT)}:{name} {fault}"
        for path in sorted((ROOT / "plr_jax").rglob("*.py"))
        for name, fault in complaints(path)
        if f"{path.relative_to(ROOT)}:{name}" not in EXCEPTIONS
    ]
    assert not faults, "\n".join(faults)


if __name__ == "__main__":
    for argument in map(Path, sys.argv[1:]):
        for path in sorted(argument.rglob("*.py")) if argument.is_dir() else [argument]:
            for name, fault in complaints(path):
                print(f"{path}:{name} {fault}")
