from pathlib import Path

import pytest

from kickbench.config import yamlio
from kickbench.config.yamlio import load_document
from kickbench.errors import SpecError


@pytest.fixture(autouse=True)
def _inside_tmp_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(text: str, name: str = "a.yaml") -> Path:
    Path(name).parent.mkdir(parents=True, exist_ok=True)
    Path(name).write_text(text, encoding="utf-8")
    return Path(name)


def problems(name: str | Path = "a.yaml", *overrides: str, **kwargs) -> list[tuple]:
    """Loads a file that has problems; returns (mark, path, message, hint) of each."""
    with pytest.raises(SpecError) as error:
        load_document(name, overrides, **kwargs)
    return [(str(p.mark), p.path, p.message, p.hint) for p in error.value.problems]


# Files


def test_aliases_repeat_their_value():
    assert load_document(write("a: &x [1, 2]\nb: *x\n")).data == {"a": [1, 2], "b": [1, 2]}


def test_a_byte_order_mark_and_windows_line_ends_are_fine():
    Path("a.yaml").write_bytes(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")
    document = load_document("a.yaml")
    assert document.data == {"a": 1, "b": 2}
    assert str(document.mark(("b",))) == "a.yaml:2:1"


# Marks


def test_every_key_and_value_knows_its_place():
    document = load_document(write("# a comment\nball:\n  friction: [1, 0.5]\n  mass:   0.1\n"))
    assert str(document.mark(("ball", "mass"))) == "a.yaml:4:3"
    assert str(document.node(("ball", "mass")).mark) == "a.yaml:4:11"
    assert str(document.mark(("ball", "friction", 1))) == "a.yaml:3:17"
    assert str(document.mark(())) == "a.yaml:1:1"


def test_the_mark_of_a_missing_key_is_its_nearest_ancestor():
    document = load_document(write("ball:\n  mass: 1\n"))
    assert str(document.mark(("ball", "radius", "x"))) == "a.yaml:1:1"
    assert str(document.mark(("ball", "mass", "x"))) == "a.yaml:2:3"
    assert str(document.mark(("floor",))) == "a.yaml:1:1"


def test_a_document_words_problems():
    document = load_document(write("ball:\n  mass: 1\n"))
    assert str(document.problem(("ball", "mass"), "too heavy")) == "a.yaml:2:3: ball.mass: too heavy"
    assert str(document.error(("ball",), "wrong", "hint")) == "a.yaml:1:1: ball: wrong (hint)"


def test_a_document_knows_its_files():
    write("a: 1\n", "sub/base.yaml")
    document = load_document(write("extends: sub/base.yaml\nb: 2\n"), ["c=3"])
    here = Path.cwd()
    assert document.file == here / "a.yaml"
    assert document.node(("a",)).origin == here / "sub" / "base.yaml"
    assert document.node(("b",)).origin == here / "a.yaml"
    assert document.node(("c",)).origin is None


# What is refused


def test_a_duplicate_key_names_the_line_of_the_first():
    write("a:\n  b: 1\n  c: 2\n  b: 3\n")
    assert problems() == [
        ("a.yaml:4:3", ("a", "b"), "duplicate key 'b'; it is first given at a.yaml:2:3", None)
    ]


def test_a_merge_key_is_a_key_like_any_other():
    assert load_document(write("a: {<<: 1}\n")).data == {"a": {"<<": 1}}


@pytest.mark.parametrize("key", ["1", "true", "~", "1e3", "? [1, 2]\n"])
def test_a_key_that_is_no_string_is_refused(key):
    write(f"a: 1\n{key}: 2\n")
    column = 3 if key[0] == "?" else 1
    found = (f"a.yaml:2:{column}", (), "a key must be a string", "write it in quotes")
    assert problems() == [found]


@pytest.mark.parametrize(
    ("text", "tag"),
    [
        ("!!python/object/apply:os.getcwd []", "!!python/object/apply:os.getcwd"),
        ("!!timestamp 2026-01-01", "!!timestamp"),
        ("!!set {b}", "!!set"),
        ("!local 1", "!local"),
    ],
)
def test_an_unknown_tag_is_refused(text, tag):
    write(f"a: {text}\n")
    message = f"unknown tag '{tag}'; expected a plain number, string, list or mapping"
    assert problems() == [("a.yaml:1:4", ("a",), message, None)]


def test_a_core_tag_needs_a_fitting_value():
    write("a: !!int x\n")
    message = "unknown tag '!!int'; expected a plain number, string, list or mapping"
    assert problems() == [("a.yaml:1:4", ("a",), message, None)]


def test_a_recursive_alias_is_refused():
    write("a: &a\n  b: *a\n")
    assert problems() == [("a.yaml:3:1", (), "not valid YAML: nested too deeply", None)]


def test_all_problems_of_a_file_are_told_at_once():
    write("a: 1\na: 2\nb: {c: !x 1}\nd: 4\nd: 5\n")
    assert [found[:2] for found in problems()] == [
        ("a.yaml:2:1", ("a",)),
        ("a.yaml:3:8", ("b", "c")),
        ("a.yaml:5:1", ("d",)),
    ]


@pytest.mark.parametrize(
    ("text", "mark", "message"),
    [
        ("a:\n\tb: 1\n", "a.yaml:2:1", "found character '\\t' that cannot start any token"),
        ("a: b: c\n", "a.yaml:1:5", "mapping values are not allowed here"),
        ("a: [1\nb: 2\n", "a.yaml:2:2", "expected ',' or ']'"),
        ("a: *x\n", "a.yaml:1:4", "found undefined alias 'x'"),
        ("a: 1\n---\nb: 2\n", "a.yaml:2:1", "but found another document"),
        ('a: "b\\U00110000"\n', "a.yaml:1:8", "an escape stands for no character"),
        ('a: "b\\Uffffffff"\n', "a.yaml:1:8", "an escape stands for no character"),
        ("a: 1\nb: \0\n", "a.yaml:2:4", "the character '\\x00' is not allowed"),
    ],
)
def test_a_syntax_error_has_its_place(text, mark, message):
    write(text)
    [(found_mark, path, found_message, _)] = problems()
    assert (found_mark, path) == (mark, ())
    assert message in found_message


def test_a_text_nested_too_deeply_is_refused():
    write("a: " + "[" * 1000)
    [(mark, _, message, _)] = problems()
    assert mark.startswith("a.yaml:1:")
    assert message == "not valid YAML: nested too deeply"


@pytest.mark.parametrize(
    ("text", "column"), [('extends: "\\ud800"', 10), ('a: ["x\\ud83d\\ude00"]', 5), ('a: {"\\udfff": 1}', 5)]
)
def test_half_a_character_is_refused(text, column):
    write(text)
    assert problems() == [
        (f"a.yaml:1:{column}", (), "not valid YAML: an escape stands for no character", None)
    ]


@pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n"])
def test_an_empty_file_is_refused(text):
    write(text)
    message = "expected keys at the top of the file, found null"
    assert problems() == [("a.yaml:1:1", (), message, None)]


@pytest.mark.parametrize(("text", "found"), [("- 1\n- 2\n", "a list of 2"), ("abc\n", "the string 'abc'")])
def test_a_file_without_keys_is_refused(text, found):
    write(text)
    assert problems() == [("a.yaml:1:1", (), f"expected keys at the top of the file, found {found}", None)]


@pytest.mark.parametrize("text", [b"a: 1\nb: \xff\n", b"a: 1\n\xc3\xa4: \xff\n"])
def test_a_byte_order_mark_does_not_shift_the_place_of_what_is_not_utf_8(text):
    Path("a.yaml").write_bytes(b"\xef\xbb\xbf" + text)
    assert problems() == [("a.yaml:2:4", (), "not UTF-8", None)]


def test_a_file_that_is_not_utf_8_is_refused():
    Path("a.yaml").write_bytes(b"a: 1\n\xc3\xa9: \xff\n")
    assert problems() == [("a.yaml:2:4", (), "not UTF-8", None)]


@pytest.mark.parametrize("name", ["mini_kickr.yaml", "mini_kicker", "mini-kicker.yaml", "mini_kicker.yml"])
def test_a_missing_file_hints_at_the_nearest_name(name):
    write("a: 1\n", "mini_kicker.yaml")
    assert problems(name) == [(name, (), f"no such file: '{name}'", "did you mean 'mini_kicker.yaml'?")]


def test_a_directory_is_no_file():
    Path("folder").mkdir()
    assert problems("folder") == [("folder", (), "'folder' cannot be read: Is a directory", None)]


def test_a_file_that_may_not_be_read_says_why(monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied")

    write("x: 1\n")
    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert problems() == [("a.yaml", (), "'a.yaml' cannot be read: Permission denied", None)]


def test_a_file_is_parsed_once_and_again_when_it_has_changed(monkeypatch):
    parsed = []
    parse = yamlio.parse
    monkeypatch.setattr(yamlio, "parse", lambda text, *rest: parsed.append(text) or parse(text, *rest))
    file = write("a: 1\n")
    assert load_document(file).data == load_document(file).data == {"a": 1}
    write("a: 2\n")
    assert load_document(file).data == {"a": 2}
    assert parsed == ["a: 1\n", "a: 2\n"]


def test_a_document_stays_as_it_is_when_another_is_made_by_an_override():
    document = load_document(write("a: {b: 0, c: 1}\n"))
    changed = document.overridden("a.b=2")
    assert (changed.data, document.data) == ({"a": {"b": 2, "c": 1}}, {"a": {"b": 0, "c": 1}})
    assert str(changed.mark(("a", "b"))) == "--set a.b=2"
    assert str(changed.mark(("a", "c"))) == "a.yaml:1:11"


# extends


def test_extends_merges_mappings_and_replaces_the_rest():
    write("m: {a: 1, b: [1, 2], c: {d: 1, e: 2}}\nz: 1\n", "base.yaml")
    document = load_document(write("y: 2\nm: {b: [3], c: {e: 5, f: 6}}\nextends: base.yaml\n"))
    assert document.data == {"m": {"a": 1, "b": [3], "c": {"d": 1, "e": 5, "f": 6}}, "z": 1, "y": 2}
    assert list(document.data) == ["m", "z", "y"]
    assert str(document.mark(("m", "a"))) == "base.yaml:1:5"
    assert str(document.mark(("m", "c", "e"))) == "a.yaml:2:17"
    assert str(document.mark(("m",))) == "a.yaml:2:1"


def test_null_in_the_child_stays_null():
    write("rewards: {fall: {weight: 1}}\n", "base.yaml")
    document = load_document(write("extends: base.yaml\nrewards: {fall: null}\n"))
    assert document.data == {"rewards": {"fall": None}}


def test_extends_is_relative_to_its_own_file():
    write("a: 1\nb: 1\n", "one/base.yaml")
    write("extends: ../one/base.yaml\nb: 2\n", "two/middle.yaml")
    assert load_document(write("extends: two/middle.yaml\n")).data == {"a": 1, "b": 2}


def test_files_that_extend_each_other_print_their_chain():
    write("extends: b.yaml\n")
    write("x: 1\nextends: sub/../c.yaml\n", "b.yaml")
    Path("sub").mkdir()
    write("extends: a.yaml\n", "c.yaml")
    message = "files extend each other in a circle: a.yaml -> b.yaml -> c.yaml -> a.yaml"
    assert problems() == [("c.yaml:1:1", ("extends",), message, None)]


def test_a_file_that_extends_itself_is_a_circle():
    write("extends: a.yaml\n")
    message = "files extend each other in a circle: a.yaml -> a.yaml"
    assert problems() == [("a.yaml:1:1", ("extends",), message, None)]


def test_a_missing_base_points_to_extends():
    write("x: 1\n", "base.yaml")
    write("a: 1\nextends: bas.yaml\n")
    hint = "did you mean 'base.yaml'?"
    assert problems() == [("a.yaml:2:1", ("extends",), "no such file: 'bas.yaml'", hint)]


def test_a_name_that_is_no_path_gets_the_rule_for_paths():
    write("extends: mini_goal\n")
    assert problems()[0][2:] == ("no such file: 'mini_goal'", "paths in a file are relative to it")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[b.yaml]", "a list of 1"),
        ("", "null"),
        ("3", "the number 3"),
        ("''", "the string ''"),
    ],
)
def test_extends_must_be_a_path(text, found):
    write(f"extends: {text}\n")
    assert problems() == [("a.yaml:1:1", ("extends",), f"expected the path of a file, found {found}", None)]


# Overrides


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("a.b=1e-3", {"a": {"b": 1e-3, "c": [1, 2]}, "n": None}),
        ("a.c=[3]", {"a": {"b": 0, "c": [3]}, "n": None}),
        ("a.c.1=on", {"a": {"b": 0, "c": [1, "on"]}, "n": None}),
        ("a={d: 1}", {"a": {"b": 0, "c": [1, 2], "d": 1}, "n": None}),
        ("a=null", {"a": None, "n": None}),
        ("a=", {"a": None, "n": None}),
        ("n.x.y=a=b", {"a": {"b": 0, "c": [1, 2]}, "n": {"x": {"y": "a=b"}}}),
        ("new.key='1'", {"a": {"b": 0, "c": [1, 2]}, "n": None, "new": {"key": "1"}}),
    ],
)
def test_an_override_replaces_or_creates(override, expected):
    assert load_document(write("a: {b: 0, c: [1, 2]}\nn:\n"), [override]).data == expected


def test_the_last_override_wins_and_has_the_mark():
    document = load_document(write("a: {b: 0, c: 1}\n"), ["a.b=1", "a.b=2"])
    assert document.data == {"a": {"b": 2, "c": 1}}
    assert str(document.mark(("a", "b"))) == str(document.node(("a", "b")).mark) == "--set a.b=2"
    assert str(document.mark(("a", "c"))) == "a.yaml:1:11"
    assert str(document.mark(("a",))) == "a.yaml:1:1"


def test_overrides_come_after_extends():
    write("a: 1\n", "base.yaml")
    assert load_document(write("extends: base.yaml\na: 2\n"), ["a=3"]).data == {"a": 3}


@pytest.mark.parametrize("text", ["a", "=1", "a..b=1", ".a=1", "a.=1", ""])
def test_a_malformed_override_says_its_form(text):
    write("a: {b: 1}\n")
    hint = "for example rewards.fall.weight=-2"
    assert problems("a.yaml", text) == [(f"--set {text}", (), "expected key.path=value", hint)]


@pytest.mark.parametrize(
    ("override", "path", "message"),
    [
        ("a.b.c=1", ("a", "b", "c"), "'a.b' is the number 1 and has no key 'c'"),
        ("l.2=1", ("l", "2"), "'l' is a list of 2 and has no key '2'"),
        ("l.x=1", ("l", "x"), "'l' is a list of 2 and has no key 'x'"),
        ("extends=b.yaml", ("extends",), "`extends` cannot be set: it is read from files only"),
        (
            "a={b: 1, b: 2}",
            ("a", "b"),
            "duplicate key 'b'; it is first given at --set a={b: 1, b: 2}",
        ),
    ],
)
def test_an_impossible_override_says_why(override, path, message):
    write("a: {b: 1}\nl: [1, 2]\n")
    assert problems("a.yaml", override) == [(f"--set {override}", path, message, None)]


def test_an_index_beyond_all_measure_is_refused():
    write("a: {b: 1}\nl: [1, 2]\n")
    key = "l." + "9" * 5000
    [(mark, _, message, _)] = problems("a.yaml", f"{key}=1")
    assert mark == f"--set {key}=1"
    assert message.startswith("'l' is a list of 2 and")


def test_an_override_with_a_syntax_error_names_itself():
    write("a: 1\n")
    [(mark, path, message, _)] = problems("a.yaml", "a=[1")
    assert (mark, path) == ("--set a=[1", ("a",))
    assert message.startswith("not valid YAML")
