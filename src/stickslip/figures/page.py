"""Self-contained HTML pages, which need neither a network nor other files."""

import base64
from html import escape
from importlib.resources import files
from string import Template

MARK = "written by stickslip"  # identifies pages and movies of this package
ROWS = 60  # largest number of rows shown of a table that is also in a file


def page(title: str, about: str, sections: list[tuple[str, str]], *, reload: int | None = None) -> str:
    """HTML page with sections (heading, HTML); `title` and `about` are plain text.

    With `reload`, a browser loads the page again after this time [s].
    """
    body = "\n".join(f"<section>\n<h2>{escape(name)}</h2>\n{text}\n</section>" for name, text in sections)
    template = Template(files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    again = "" if reload is None else f'\n<meta http-equiv="refresh" content="{reload}">'
    return template.substitute(mark=MARK, title=escape(title), about=escape(about), body=body, again=again)


def table(columns: list[str], rows: list[list[str]], *, classes: dict[str, str] | None = None, file: str = "") -> str:
    """HTML table of plain text; `classes` gives the kind of each column: number, note or verdict.

    If a `file` contains all rows, the table shows the first `ROWS` and states how many more the file has.
    """
    known, more = classes or {}, len(rows) - ROWS if file else 0
    rows = rows[:ROWS] if more > 0 else rows

    def cell(kind: str, name: str, text: str) -> str:
        style = known.get(name, "")
        style = text.split(" ")[0] if style == "verdict" and kind == "td" else style
        return f'<{kind} class="{escape(style)}">{escape(text)}</{kind}>'

    head = "".join(cell("th", name, name) for name in columns)
    body = "\n".join(
        "<tr>" + "".join(cell("td", name, text) for name, text in zip(columns, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>' + (
        paragraph(f"and {more} more in {file}", kind="soft") if more > 0 else ""
    )


def pictures(shown: dict[str, bytes]) -> str:
    """HTML with embedded pictures (PNG or GIF), given by caption."""
    out = []
    for caption, content in shown.items():
        text, kind = escape(caption[:1].upper() + caption[1:]), "gif" if content.startswith(b"GIF8") else "png"
        source = f'src="data:image/{kind};base64,{base64.b64encode(content).decode()}"'
        out.append(f'<figure><img alt="{text}" {source}><figcaption>{text}</figcaption></figure>')
    return '<div class="figures">\n' + "\n".join(out) + "\n</div>"


def listing(text: str) -> str:
    """HTML of preformatted text."""
    return f"<pre>{escape(text)}</pre>"


def folded(summary: str, content: str) -> str:
    """HTML that is hidden until it is expanded."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}\n</details>"


def paragraph(text: str, *, kind: str = "") -> str:
    """Paragraph of plain text; `kind` is "soft", "verdict", "warning", or "absent" for missing content."""
    return f'<p class="{escape(kind)}">{escape(text)}</p>'


def embedded_document(document: str, title: str) -> str:
    """Embed a separate document, whose scripts run but cannot load other files."""
    return f'<iframe title="{escape(title)}" allow="fullscreen" srcdoc="{escape(document)}"></iframe>'
