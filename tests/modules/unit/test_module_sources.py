"""The modules are single files that run on Python 2.7 and on 3.7 and later.

Printers in the field run klippy on either, and the hosts differ in which of
their own modules can be imported under which name.
"""

from __future__ import annotations

import ast
import io
import re
import shutil
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MODULES = sorted(ROOT.glob("*.py"))

# Of the standard library what is in Python 2.7 and 3 under the same name;
# members that only one of them has are left to vermin.
IMPORTABLE = {
    "__future__",
    "ast",
    "bisect",
    "collections",
    "contextlib",
    "difflib",
    "copy",
    "functools",
    "heapq",
    "itertools",
    "json",
    "logging",
    "math",
    "operator",
    "os",
    "re",
    "string",
    "struct",
    "sys",
    "textwrap",
    "threading",
    "time",
    "traceback",
}


def problems(path):
    """What keeps a file from running everywhere, one text for each."""
    content = path.read_bytes()
    try:
        text = content.decode("ascii")
    except UnicodeDecodeError as error:
        return [f"not ASCII: {error}"]
    try:
        tree = ast.parse(text)
    except SyntaxError as error:
        return [f"not Python 3: {error}"]
    found = version_problems(path)
    for node in ast.walk(tree):
        found += node_problems(node)
    found += token_problems(text)
    if "register_components" in text:
        # Kalico greps for the word and calls what it takes for a function.
        found.append("contains register_components")
    return found


def version_problems(path):
    done = subprocess.run(
        [sys.executable, "-c", "import vermin; vermin.main()", "--no-tips"]
        + ["--violations", "--target=2.7-", "--target=3.7-", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    # A checker that does not run would find a problem in every file.
    assert "Minimum required versions" in done.stdout, done.stderr
    return [done.stdout] if done.returncode else []


def node_problems(node):
    """Problems that vermin does not report."""
    line = getattr(node, "lineno", 0)
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        # A relative import is one of a host module or of a sibling.
        names = ["." * node.level + (node.module or "")]
    elif isinstance(node, ast.Name) and node.id == "__import__":
        names = [node.id]
    else:
        names = []
    found = [
        f"line {line}: imports {name}"
        for name in names
        if name.split(".")[0] not in IMPORTABLE
    ]
    if isinstance(node, ast.Call) and not node.args:
        if isinstance(node.func, ast.Name) and node.func.id == "super":
            found.append(f"line {line}: super() without arguments")
    elif isinstance(node, ast.ClassDef) and not node.bases:
        found.append(f"line {line}: class {node.name} has no base")
    elif isinstance(node, ast.FunctionDef) and returns_from_generator(node):
        found.append(f"line {line}: generator {node.name} returns a value")
    return found


def returns_from_generator(function):
    own = list(own_nodes(function))
    return any(isinstance(node, ast.Yield) for node in own) and any(
        isinstance(node, ast.Return) and node.value is not None for node in own
    )


def own_nodes(function):
    """The nodes of a function without those of functions inside it."""
    pending = list(function.body)
    while pending:
        node = pending.pop()
        yield node
        if not isinstance(node, (ast.FunctionDef, ast.Lambda, ast.ClassDef)):
            pending += ast.iter_child_nodes(node)


def token_problems(text):
    """What Python 2.7 does not allow and a syntax tree does not show.

    Formatters put a comma behind a starred argument where the arguments take
    several lines.
    """
    ignored = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE)
    found = []
    # For each open bracket the token that began its current item, the tokens
    # since the last comma being one item.
    first = [None]
    previous_first = [None]
    previous = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in ignored:
            continue
        if token.string in ("(", "[", "{"):
            first[-1] = first[-1] or token.string
            first.append(None)
            previous_first.append(None)
        elif token.string in (")", "]", "}"):
            if previous == "," and previous_first[-1] in ("*", "**"):
                found.append(f"line {token.start[0]}: comma after * argument")
            first.pop()
            previous_first.pop()
        elif token.string == ",":
            previous_first[-1], first[-1] = first[-1], None
        else:
            if token.type == tokenize.NUMBER and "_" in token.string:
                found.append(f"line {token.start[0]}: {token.string}")
            first[-1] = first[-1] or token.string
        previous = token.string
    return found


def find_python2():
    """(interpreter, "") or (None, what was tried)."""
    on_path = shutil.which("python2.7")
    candidates = [Path(on_path)] if on_path else []
    # Version managers leave a stub that only says it is not installed; the
    # versions stand beside the folder of the stubs
    roots = [Path.home() / ".pyenv", *(c.parents[1] for c in candidates)]
    for root in dict.fromkeys(roots):
        candidates += sorted(root.glob("versions/2.7*/bin/python2.7"))
    program = "import sys; print('%d.%d' % sys.version_info[:2])"
    for candidate in candidates:
        done = subprocess.run(
            [str(candidate), "-c", program],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == 0 and done.stdout.strip() == "2.7":
            return candidate, ""
    tried = ", ".join(map(str, candidates)) or "none on PATH"
    return None, f"no Python 2.7 that runs ({tried})"


def import_on_python2(python, path):
    """Import a file, as klippy does; return what went wrong or nothing."""
    program = "import sys; sys.path.insert(0, sys.argv[1]); __import__('%s')"
    done = subprocess.run(
        [str(python), "-B", "-c", program % path.stem, str(path.parent)],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stderr if done.returncode else ""


@pytest.fixture(scope="module")
def python2():
    python, reason = find_python2()
    if python is None:
        pytest.skip(reason)
    return python


def test_there_are_modules():
    assert MODULES


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_module_runs_everywhere(path):
    assert problems(path) == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_module_imports_on_python2(path, python2):
    assert import_on_python2(python2, path) == ""


GOOD = """\
from __future__ import division
import collections, logging

Site = collections.namedtuple("Site", ("x", "y"))

class Base(object):
    def __init__(self, *args, **options):
        super(Base, self).__init__()
        self.sites = [Site(x, y) for x, y in args]

def call(function, *args):
    try:
        return function(
            1, 2,
            *args)
    except (TypeError, ValueError) as e:
        logging.info("failed: %s", e)
        raise

def numbers(a, b,):
    yield (a, b,)
    yield [a * b, a ** b,]

def load_config(config):
    return Base((1, 2), name="%s %.3f" % ("a", 1. / 3.))
"""

# Each is one line too many for some Python or some host.
BAD = {
    "f-string": 'a = 1\nb = f"{a}"',
    "argument annotation": "def f(a: int):\n    pass",
    "return annotation": "def f() -> int:\n    pass",
    "variable annotation": "a: int = 1",
    "keyword-only argument": "def f(*, a=1):\n    pass",
    "keyword-only after star": "def f(*b, a=1):\n    pass",
    "positional-only argument": "def f(a, /):\n    pass",
    "nonlocal": "def f():\n    a = 1\n    def g():\n        nonlocal a",
    "walrus": "if (a := 1):\n    pass",
    "super": "class A(object):\n    def f(self):\n        super().f()",
    "raise from": "def f(e):\n    raise ValueError() from e",
    "yield from": "def f(a):\n    yield from a",
    "generator return": "def f():\n    yield 1\n    return 2",
    "star assignment": "a, *b = (1, 2, 3)",
    "two stars in a display": "a = {}\nb = {**a}",
    "star in a display": "a = []\nb = [*a]",
    "two starred arguments": "def f(*a):\n    f(*a, *a)",
    "metaclass": "class A(object, metaclass=type):\n    pass",
    "old-style class": "class A:\n    pass",
    "underscores in a number": "a = 1_000",
    "comma after star parameter": "def f(\n    *a,\n):\n    pass",
    "comma after star argument": "def f(a):\n    f(\n        *a,\n    )",
    "comma after two stars": "def f(a):\n    f(\n        1,\n        **a,\n    )",
    "async": "async def f():\n    pass",
    "match": "match 1:\n    case 1:\n        pass",
    "matrix product": "def f(a, b):\n    return a @ b",
    "print statement": "print 'a'",
    "old except": "try:\n    pass\nexcept ValueError, e:\n    pass",
    "not ASCII": "# \u00b5m",
    "suppress": "import contextlib\na = contextlib.suppress(ValueError)",
    "exit stack": "import contextlib\na = contextlib.ExitStack()",
    "isclose": "import math\na = math.isclose(1., 2.)",
    "monotonic": "import time\na = time.monotonic()",
    "lru_cache": "import functools\na = functools.lru_cache(None)",
    "enum": "import enum",
    "dataclasses": "import dataclasses",
    "renamed module": "import ConfigParser",
    "host module": "import mcu",
    "relative host module": "from . import probe",
    "relative name": "from .probe import PrinterProbe",
    "host package": "from klippy.extras import probe",
    "extras": "import extras.probe",
    "guarded": "try:\n    from . import probe\nexcept ImportError:\n    pass",
    "in a function": "def f():\n    import probe",
    "sibling": "import auto_z_offset",
    "by call": "a = __import__('probe')",
    "importlib": "import importlib",
    "word for Kalico": "# register_components",
}


def test_common_code_has_no_problems(tmp_path):
    path = tmp_path / "sample.py"
    path.write_text(GOOD, encoding="ascii")
    assert problems(path) == []


def test_common_code_imports_on_python2(tmp_path, python2):
    path = tmp_path / "sample.py"
    path.write_text(GOOD, encoding="ascii")
    assert import_on_python2(python2, path) == ""


@pytest.mark.parametrize("sample", BAD)
def test_problem_is_found(sample, tmp_path):
    path = tmp_path / "sample.py"
    path.write_text(BAD[sample] + "\n", encoding="utf-8")
    assert problems(path)


def test_python2_finds_syntax_of_python3(tmp_path, python2):
    path = tmp_path / "sample.py"
    path.write_text(BAD["f-string"], encoding="ascii")
    assert re.search("SyntaxError", import_on_python2(python2, path))


SHARED = re.compile(
    r"^ *# --- shared: ([\w ]+) ---\n(.*?)^ *# --- end ---\n", re.M | re.S
)


def shared_blocks(text):
    """Code that modules have in common, by name."""
    blocks = SHARED.findall(text)
    names = [name for name, _ in blocks]
    assert len(set(names)) == len(names) == text.count("# --- shared"), names
    assert text.count("# --- end ---") == len(names)
    return dict(blocks)


def different_blocks(texts):
    """Names of the blocks that are not the same wherever they are."""
    found = {}
    for text in texts:
        for name, block in shared_blocks(text).items():
            found.setdefault(name, []).append(block)
    return sorted(n for n, copies in found.items() if len(set(copies)) > 1)


def test_shared_code_is_the_same_in_every_module():
    assert not different_blocks(path.read_text() for path in MODULES)


def test_shared_code_is_in_more_than_one_module():
    found = [n for p in MODULES for n in shared_blocks(p.read_text())]
    assert len(found) > 20
    assert [name for name in found if found.count(name) < 2] == []


def test_difference_in_shared_code_is_found():
    a = "# --- shared: a ---\nx = 1\n# --- end ---\n"
    assert different_blocks([a, a.replace("1", "2")]) == ["a"]
    assert different_blocks([a, "y = 2\n" + a]) == []
