"""Public names, errors, command help and page texts use the field's terms: a misused word is refused with its term."""

import ast
import re
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.harness.root import ROOT

#: For each word that is misused in names and texts: the correct terms.
TERMS = {
    "told tell tells": "report, send, configure, specify, print, receive",
    "asked asks": "request, query",
    "says said": "message, text, state, report",
    "nobody somebody whoever anybody": "the client, the operator, no client, any user",
    "anew": "again, restart",
    "beside": "next to, in addition to, compared with",
    "wanted wish": "desired, requested",
    "led leader": "streamed, externally commanded, source",
    "askew": "misaligned",
    "hunts": "oscillates",
    "heard hears": "received",
    "hardly": "almost no, barely with its number",
    "stands stood": "is, is at, is stationary",
}
#: Words that are misused only in names; in a sentence these words may be correct.
NAME_TERMS = {"tried": "checked, attempted", "seen": "snapshot, measured", "placed": "position", "fresh": "valid, new"}
WORDS = {word: terms for words, terms in TERMS.items() for word in words.split()}
#: Names of functions whose text arguments are the command help.
HELP_CALLS = ("add_argument", "add_parser", "ArgumentParser")


def words(name: str) -> list[str]:
    """Split a name in snake_case or CamelCase."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]


def public_names(body: list[ast.stmt]) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if not node.name.startswith("_"):
                yield node.name
            if isinstance(node, ast.ClassDef):
                yield from public_names(node.body)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (each.id for each in targets if isinstance(each, ast.Name) and not each.id.startswith("_"))


def texts(node: ast.AST) -> Iterator[str]:
    for each in ast.walk(node):
        if isinstance(each, ast.Constant) and isinstance(each.value, str):
            yield each.value


def user_texts(tree: ast.Module) -> Iterator[str]:
    """Yield the texts of raised errors and of command help."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and node.exc is not None:
            yield from texts(node.exc)
        elif isinstance(node, ast.Call):
            function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if function in HELP_CALLS:
                for keyword in node.keywords:
                    yield from texts(keyword.value) if keyword.arg in ("help", "description", "epilog") else ()


def misused(text: str) -> list[str]:
    return [f"'{word}' in {text!r}: {WORDS[word]}" for word in re.findall(r"[a-z]+", text.lower()) if word in WORDS]


class PageTexts(HTMLParser):
    """Parser that collects the texts and titles of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self._hidden = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._hidden = tag if tag in ("script", "style") else ""
        self.found += [value for name, value in attrs if name in ("title", "placeholder", "aria-label") and value]

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.found.append(data)


def in_files(paths: list[Path], found: Callable[[str], list[str]]) -> list[str]:
    """Return the problems found in the text of each file, with the file's name."""
    return [
        f"{path.relative_to(ROOT)}: {problem}" for path in paths for problem in found(path.read_text(encoding="utf-8"))
    ]


def in_module(source: str) -> list[str]:
    tree = ast.parse(source)
    bad = [
        f"the name '{name}' has '{word}': {terms}"
        for name in public_names(tree.body)
        for word in words(name)
        if (terms := WORDS.get(word) or NAME_TERMS.get(word))
    ]
    return bad + [problem for text in user_texts(tree) for problem in misused(text)]


def in_script(source: str) -> list[str]:
    code = re.sub(r"(^|\s)//.*$", "", source, flags=re.MULTILINE)
    strings = re.findall(r'"((?:[^"\\\n]|\\.)*)"|`((?:[^`\\]|\\.)*)`', code)
    sentences = [re.sub(r"\$\{[^}]*\}", "", text) for pair in strings for text in pair if " " in text]
    return [problem for text in sentences for problem in misused(text)]


def in_page(source: str) -> list[str]:
    return [problem for text in PageTexts(source).found for problem in misused(text)]


@pytest.mark.parametrize("room", ["core", "station", "web"])
def test_names_errors_and_help_use_the_terms_of_the_field(room: str) -> None:
    modules = sorted((ROOT / room).rglob("*.py"))
    names = {path: WORDS.keys() & set(words(path.stem)) for path in modules}

    assert in_files(modules, in_module) == []
    assert {path: found for path, found in names.items() if found} == {}


def test_page_texts_use_the_terms_of_the_field() -> None:
    static = ROOT / "web" / "static"

    assert in_files(sorted(static.rglob("*.js")), in_script) == []
    assert in_files(sorted(static.rglob("*.html")), in_page) == []


def test_a_misused_word_is_found_in_names_errors_help_and_pages() -> None:
    source = """class Told:
    wanted = 1

    def go(self):
        raise ValueError(f"nobody {self} came")

parser.add_argument("--a", help="says more")
"""

    assert [problem.split("'")[-2] for problem in in_module(source)[:2]] == ["told", "wanted"]
    assert [problem.split("'")[1] for problem in in_module(source)[2:]] == ["says", "nobody"]
    assert len(in_page('<p title="a wish">led</p><script>told</script>')) == 2
    assert len(in_script('x = "is told"; y = `${z} wanted`; // "told and told"')) == 2
