"""Wording of changed docstrings, messages and pages: `python -m tests.structure.prose [BASE]`, part of `make lint`.

Lines that differ from BASE, by default the common ancestor with origin/main, or else the previous commit, are searched.
"""

import io
import re
import subprocess
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
SEARCHED = *(f"src/stickslip/*.{end}" for end in ("py", "h", "cpp")), "*.md"
PHRASES = {
    r"\bwhat(ever)?\b": "name the thing instead of 'what'",
    r'"""(how|whether)\b': "begin with a noun or a verb, such as 'Method of …' or 'Return True if …'",
    r"\b(tells?|told|asks?|asked|says?|said)\b": "write 'states', 'requires', 'returns' …",
    r"\b(is|are|was|were) (seen|taken (as|for|to))\b": "write 'is found', 'is treated as', 'is assumed'",
    r"\brefus\w+": "write 'rejects', 'is not accepted', 'raises'",
    r"\b(was|were) given[:,]|\b(was|were) both given\b": "write '… must be …, got …', '… exclude each other'",
    r"\bbut for\b|\bso many\b": "write 'except for', 'this many'",
    r"\b(folder|file|law|test)s? of a (run|user|laboratory)\b": "write a compound: 'run folder', 'user-defined law'",
    r"\bof (its|their|your) own\b": "write 'separate', 'additional', 'user-defined'",
    r"\bthat nothing\b|\bnothing that\b": "write 'unresisted', 'unsupported', 'no …'",
    r"\bnot understood\b": "write 'unknown'",
    r"\b(is|are) no (file|folder|number|path|longer than)\b": "write 'is not a …'",
    r"\bthe one before\b": "write 'the previous one'",
}
IN_SOURCES = (
    r"\bwhat(ever)?\b",
    r"\b(tells?|told|asks?|asked|says?|said)\b",
    r"\bnot understood\b",
)  # natural on pages
ALLOWED = {
    '"not understood"': "group of names in JSON output, documented for programs",
    '"tell"': "value of an option of `aqs`",
    "what, needed :": "name of a parameter",
}


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True).stdout.strip()


def faults(text: str, *, page: bool = False) -> list[str]:
    """Phrases in a line of prose, each with advice; placeholders in braces and code in backticks are ignored."""
    text = re.sub(r"`[^`]*`|\{[^{}]*\}", "_", text)
    for phrase in ALLOWED:
        text = text.replace(phrase, "_")
    phrases = {pattern: advice for pattern, advice in PHRASES.items() if not (page and pattern in IN_SOURCES)}
    matches = ((re.search(pattern, text, re.IGNORECASE), advice) for pattern, advice in phrases.items())
    return [f"{match[0]!r}: {advice}" for match, advice in matches if match]


def prose(path: Path) -> dict[int, str]:
    """Comments and strings of a source file by line, or lines of a page; lines of code are left out."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        blocks = text.split("```")  # every other one is code
        plain = "".join(re.sub(r"[^\n]", "", block) if k % 2 else block for k, block in enumerate(blocks))
        return dict(enumerate(plain.split("\n"), 1))
    if path.suffix != ".py":
        comments = ((k, line.partition("//")[2]) for k, line in enumerate(text.split("\n"), 1))
        return {k: comment for k, comment in comments if comment}
    lines: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)):
            for k, line in enumerate(token.string.split("\n"), token.start[0]):
                lines[k] = f"{lines.get(k, '')} {line}" if " " in line.strip() else lines.get(k, "")
    return lines


def changed_lines(base: str) -> list[tuple[Path, int]]:
    """Source files and numbers of the lines that differ from a commit."""
    path, found = ROOT, []
    for line in _git("diff", "-U0", base, "--", *SEARCHED).split("\n"):
        if line.startswith("+++ b/"):
            path = ROOT / line[6:]
        elif match := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line):
            found += [(path, int(match[1]) + k) for k in range(int(match[2] or 1))]
    return found


if __name__ == "__main__":
    head, ancestor = _git("rev-parse", "HEAD"), _git("merge-base", "HEAD", "origin/main")
    lines = changed_lines(sys.argv[1] if sys.argv[1:] else ancestor if ancestor not in ("", head) else "HEAD~")
    texts = {path: prose(path) for path in {path for path, _ in lines} if path.is_file()}
    problems = [
        f"{path}:{k}: {fault}"
        for path, k in lines
        for fault in faults(texts.get(path, {}).get(k, ""), page=path.suffix == ".md")
    ]
    sys.exit("\n".join(problems) or None)
