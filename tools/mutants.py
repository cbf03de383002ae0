#!/usr/bin/env python3
"""mutants.py FOLDER [OPTIONS]: runs the tests on every mutant that cargo-mutants lists, all in one build.

A mutant is one place of the code changed: another operator, a guard that always holds, a function that returns at once.
cargo-mutants builds the tests anew for each; here a copy of the sources holds all mutants at once, each behind a switch
that the environment sets (mutant schemata: Untch, Offutt and Harrold, ISSTA 1993). Each test runs once without a mutant,
alone in its process, and notes the switches that it passes. Then the tests that pass a mutant run with it, first those
that promise most for their time, until one fails or takes far too long.

Constants, and functions that run while the compiler does, have no switches: *not switchable*.

FOLDER keeps the copy, the build and `results.tsv`, from which the next run of the same code continues; remove the lines to
be tried again. `mutants.toml`, beside this script, says by file why tests notice some mutants not: `function: words; words`,
each of the words in the mutant's line or in cargo-mutants' name of the change. `survivors.txt` in FOLDER lists the others
that were not noticed, and the reasons that fit nothing. Needs cargo-mutants and the Python packages tree-sitter and
tree-sitter-rust.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tree_sitter_rust
from tree_sitter import Language, Node, Parser

ROOT = Path(__file__).resolve().parent.parent
PARTS = {
    "codec": "src/codec/",
    "query": "src/query/",
    "reach": "src/reach/",
    "archive": "src/archive/",
    "base": "crates/base/",
}

# A test that takes longer without a mutant is left out.
LONGEST_S = 60.0

# Added to the copy of SWITCHED. Without SLICEWALK_MUTANT, a process notes each mutant that it passes as a byte of the file
# SLICEWALK_MUTANTS_SEEN.
SWITCHED = "crates/base/src/lib.rs"
SWITCH = """
/// Whether mutant `id` is switched on.
#[inline]
pub fn mutant(id: u32) -> bool {
    use std::sync::atomic::Ordering::Relaxed;
    match switch::ACTIVE.load(Relaxed) {
        switch::NOTING => { switch::note(id); false }
        active => active == id,
    }
}

mod switch {
    use std::os::unix::fs::FileExt;
    use std::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed};
    use std::sync::OnceLock;

    pub const NOTING: u32 = u32::MAX;
    pub static ACTIVE: AtomicU32 = AtomicU32::new(NOTING);
    static SEEN: [AtomicU8; COUNT] = [const { AtomicU8::new(0) }; COUNT];
    static FILE: OnceLock<Option<std::fs::File>> = OnceLock::new();

    pub fn note(id: u32) {
        if SEEN[id as usize].load(Relaxed) == 0 {
            first(id);
        }
    }

    #[cold]
    fn first(id: u32) {
        let file = FILE.get_or_init(|| {
            if let Some(active) = std::env::var("SLICEWALK_MUTANT").ok().and_then(|id| id.parse().ok()) {
                ACTIVE.store(active, Relaxed);
                return None;
            }
            let file = std::env::var_os("SLICEWALK_MUTANTS_SEEN")
                .and_then(|path| std::fs::OpenOptions::new().write(true).open(path).ok());
            if file.is_none() {
                ACTIVE.store(u32::MAX - 1, Relaxed);
            }
            file
        });
        if let Some(file) = file {
            SEEN[id as usize].store(1, Relaxed);
            file.write_all_at(&[1], u64::from(id)).unwrap();
        }
    }
}
"""


@dataclass
class Mutant:
    id: int
    file: str
    function: str
    genre: str
    name: str
    replacement: str
    start: int
    end: int
    state: str = "not built"


@dataclass(eq=False)
class Test:
    program: str
    folder: str
    name: str
    seconds: float = 0.0
    passes: set[int] = field(default_factory=set)


def listed() -> list[Mutant]:
    """The mutants of cargo-mutants, with their places in bytes."""
    shown = subprocess.run(
        ["cargo", "mutants", "--list", "--json"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    )
    lines: dict[str, list[str]] = {}
    mutants = []
    for number, entry in enumerate(json.loads(shown.stdout)):
        name = entry["file"]
        if name not in lines:
            lines[name] = (ROOT / name).read_text().splitlines(keepends=True)

        def byte(place: dict[str, int], text: list[str] = lines[name]) -> int:
            above = sum(len(line.encode()) for line in text[: place["line"] - 1])
            return above + len(text[place["line"] - 1][: place["column"] - 1].encode())

        span, function = entry["span"], (entry["function"] or {}).get("function_name", "")
        change = entry["genre"], entry["name"], entry["replacement"]
        mutants.append(Mutant(number, name, f"{name} {function}", *change, byte(span["start"]), byte(span["end"])))
    return mutants


class Rewriter:
    """Rewrites one file with the switches of its mutants."""

    def __init__(self, source: bytes, mutants: list[Mutant]) -> None:
        self.source = source
        self.placed: set[int] = set()
        self.by_place: dict[tuple[int, int], list[Mutant]] = defaultdict(list)
        for mutant in mutants:
            self.by_place[mutant.start, mutant.end].append(mutant)
        parser = Parser(Language(tree_sitter_rust.language()))
        self.tree = parser.parse(source)

    def text(self, node: Node) -> str:
        return self.source[node.start_byte : node.end_byte].decode()

    def at(self, node: Node, genre: str) -> list[Mutant]:
        found = [m for m in self.by_place.get((node.start_byte, node.end_byte), []) if m.genre == genre]
        self.placed.update(m.id for m in found)
        return found

    def rewritten(self) -> str:
        return self.emit(self.tree.root_node)

    def emit(self, node: Node) -> str:
        match node.type:
            case "token_tree" | "macro_invocation" | "attribute_item" | "const_item" | "static_item":
                return self.text(node)
            case "function_item" if any(
                c.type == "function_modifiers" and "const" in self.text(c) for c in node.children
            ):
                return self.text(node)
            case "binary_expression" | "compound_assignment_expr":
                return self.operator(node)
            case "unary_expression":
                return self.unary(node)
            case "match_arm":
                return self.arm(node)
            case "struct_expression":
                return self.structure(node)
            case "block" if node.parent is not None and node.parent.type == "function_item":
                return self.body(node)
        return self.children(node)

    def children(self, node: Node, changed: dict[int, str] | None = None) -> str:
        """Text of a node, some of whose children, named by their ids, become another text."""
        out, at = [], node.start_byte
        for child in node.children:
            out.append(self.source[at : child.start_byte].decode())
            text = changed.get(child.id) if changed else None
            out.append(self.emit(child) if text is None else text)
            at = child.end_byte
        out.append(self.source[at : node.end_byte].decode())
        return "".join(out)

    def switched(self, mutants: list[tuple[Mutant, str]], otherwise: str) -> str:
        for mutant, text in mutants:
            # The code as written comes first and so decides the types.
            text = f"(if !{call(mutant)} {{ ({otherwise}) }} else {{ ({marked(mutant, text)}) }})"
            otherwise = f"/*[{mutant.id}*/{text}/*{mutant.id}]*/"
        return otherwise

    def operator(self, node: Node) -> str:
        sign = node.child_by_field_name("operator")
        assert sign is not None
        mutants = self.at(sign, "BinaryOperator")
        whole = (
            self.source[node.start_byte : sign.start_byte].decode(),
            self.source[sign.end_byte : node.end_byte].decode(),
        )
        return self.switched([(m, whole[0] + m.replacement + whole[1]) for m in mutants], self.children(node))

    def unary(self, node: Node) -> str:
        sign = node.children[0]
        mutants = self.at(sign, "UnaryOperator")
        rest = self.source[sign.end_byte : node.end_byte].decode()
        return self.switched([(m, rest) for m in mutants], self.children(node))

    def arm(self, node: Node) -> str:
        pattern = node.child_by_field_name("pattern")
        assert pattern is not None
        guard = pattern.child_by_field_name("condition")
        deleted = self.arms(node)
        if guard is not None:
            held = self.emit(guard)
            for mutant in self.at(guard, "MatchArmGuard"):
                held = f"({call(mutant)} || {held})" if mutant.replacement == "true" else f"(!{call(mutant)} && {held})"
            held = "".join(f"!{call(m)} && " for m in deleted) + held
            return self.children(node, {pattern.id: self.children(pattern, {guard.id: held})})
        if deleted:
            guards = " && ".join(f"!{call(m)}" for m in deleted)
            return self.children(node, {pattern.id: self.children(pattern) + f" if {guards}"})
        return self.children(node)

    def arms(self, node: Node) -> list[Mutant]:
        """Mutants without this arm; their span may end before its comma."""
        ends = {node.end_byte, *(child.end_byte for child in node.children)}
        found = [m for end in ends for m in self.by_place.get((node.start_byte, end), []) if m.genre == "MatchArm"]
        self.placed.update(m.id for m in found)
        return found

    def structure(self, node: Node) -> str:
        body = node.child_by_field_name("body")
        assert body is not None
        base = next((child for child in body.children if child.type == "base_field_initializer"), None)
        changed = {}
        if base is not None:
            rest = self.text(base).removeprefix("..").strip()
            name = node.child_by_field_name("name")
            assert name is not None
            for child in body.children:
                if child.type not in ("field_initializer", "shorthand_field_initializer"):
                    continue
                label = child.child_by_field_name("field")
                value = child.child_by_field_name("value")
                key = self.text(label) if label is not None else self.text(child)
                given = self.emit(value) if value is not None else key
                other = (
                    f"<{self.text(name)} as Default>::default().{key}"
                    if rest == "Default::default()"
                    else f"({rest}).{key}.clone()"
                )
                mutants = self.fields(child)
                if mutants:
                    changed[child.id] = f"{key}: " + self.switched([(m, other) for m in mutants], given)
        return self.children(node, {body.id: self.children(body, changed)}) if changed else self.children(node)

    def fields(self, node: Node) -> list[Mutant]:
        """Mutants without this field; their span ends after its comma."""
        found = [m for (start, _), all_here in self.by_place.items() if start == node.start_byte for m in all_here]
        found = [m for m in found if m.genre == "StructField"]
        self.placed.update(m.id for m in found)
        return found

    def body(self, node: Node) -> str:
        """A function's body, which may return at once. The span of these mutants is that of the statements."""
        starts = {child.start_byte for child in node.children}
        ends = {child.end_byte for child in node.children}
        found = []
        for (start, end), mutants in self.by_place.items():
            if start in starts and end in ends:
                # One function has one type behind `impl`, whatever it returns.
                found += [m for m in mutants if m.genre == "FnValue" and " -> impl " not in m.name]
        self.placed.update(m.id for m in found)
        returns = "".join(f" if {call(m)} {{ {marked(m, f'return {m.replacement};')} }}" for m in found)
        text = self.children(node)
        return "{" + returns + text[1:]


def call(mutant: Mutant) -> str:
    return f"::slicewalk_base::mutant({mutant.id})"


def marked(mutant: Mutant, text: str) -> str:
    return f"/*<{mutant.id}*/{text}/*{mutant.id}>*/"


class Build:
    """The copy with all mutants that compile, and its test programs."""

    def __init__(self, folder: Path, mutants: list[Mutant], packages: list[str]) -> None:
        self.packages = [f"--package={name}" for name in packages]
        self.tree = folder / "tree"
        self.target = folder / "target"
        self.states = folder / "states.json"
        self.mutants = mutants
        self.environment = os.environ | {
            "CARGO_TARGET_DIR": str(self.target),
            "RUSTFLAGS": "--cap-lints=allow",
            "CARGO_PROFILE_RELEASE_LTO": "off",
            "CARGO_PROFILE_RELEASE_DEBUG": "0",
            "CARGO_PROFILE_RELEASE_CODEGEN_UNITS": "16",
            "CARGO_PROFILE_RELEASE_OPT_LEVEL": "2",
            "CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS": "true",
            "CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS": "true",
        }

    def copy(self) -> None:
        shown = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
        rewritten = {mutant.file for mutant in self.mutants} | {SWITCHED}
        for name in ["Cargo.lock", *shown.stdout.split("\0")]:
            if (ROOT / name).is_file() and name not in rewritten:
                self.write(name, (ROOT / name).read_bytes())
        switch = SWITCH.replace("COUNT", str(len(self.mutants) + 1))
        self.write(
            SWITCHED, f"{(ROOT / SWITCHED).read_text()}\nextern crate self as slicewalk_base;\n{switch}".encode()
        )

    def write(self, name: str, content: bytes) -> None:
        """Writes a file unless it has this content, so that Cargo sees changes alone."""
        path = self.tree / name
        if not path.exists() or path.read_bytes() != content:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            shutil.copymode(ROOT / name, path)

    def rewrite(self) -> None:
        files = defaultdict(list)
        for mutant in self.mutants:
            files[mutant.file].append(mutant)
        for name, all_of_file in files.items():
            usable = [m for m in all_of_file if m.state == "not built"]
            rewriter = Rewriter((ROOT / name).read_bytes(), usable)
            self.write(name, rewriter.rewritten().encode())
            for mutant in usable:
                if mutant.id not in rewriter.placed:
                    mutant.state = "not switchable"

    def cargo(self, *arguments: str) -> list[dict[str, Any]]:
        run = subprocess.run(
            ["cargo", *arguments, "--message-format=json"],
            check=False,
            cwd=self.tree,
            env=self.environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        return [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]

    def settle(self) -> None:
        """Leaves out mutants until the rest compiles, alone and with the tests."""
        if self.states.exists():
            states = json.loads(self.states.read_text())
            if states.keys() != {mutant.name for mutant in self.mutants}:
                sys.exit(f"{self.states}: of other code than today's; give an empty folder")
            for mutant in self.mutants:
                mutant.state = states[mutant.name]
        self.copy()
        for targets in ("--lib", "--tests"):
            while self.refused(targets):
                pass
        self.states.write_text(json.dumps({m.name: m.state for m in self.mutants}))

    def refused(self, targets: str) -> bool:
        """Leaves out the mutants at which the compiler reports errors; False without errors."""
        self.rewrite()
        self.found: dict[tuple[str, str], list[tuple[int, int, int]]] = {}
        messages = self.cargo(
            "check", "--release", "--package=slicewalk", "--package=slicewalk-base", "--quiet", targets
        )
        errors = [
            m["message"] for m in messages if m.get("reason") == "compiler-message" and m["message"]["level"] == "error"
        ]
        errors = [e for e in errors if e["spans"]]
        if not errors:
            return False
        # Errors within a mutant are its own; the others may follow from them, or show that a switch changes types around it.
        dropped = {id for error in errors for id in self.holding(error, "<", ">")}
        state = "does not compile"
        if not dropped:
            dropped = {id for error in errors for id in self.holding(error, "[", "]") or self.arm_below(error)}
            state = "not switchable"
        if not dropped:
            sys.exit(f"the copy does not compile:\n{errors[0]['rendered']}")
        for id in dropped:
            self.mutants[id].state = state
        print(f"{len(errors)} errors, {len(dropped)} mutants: {state}", flush=True)
        return True

    def holding(self, error: dict[str, Any], opening: str, closing: str) -> list[int]:
        """The innermost mutant between whose marks a span of an error lies, if any."""
        for spans in ([s for s in error["spans"] if s["is_primary"]], error["spans"]):
            best: tuple[int, int] | None = None
            for span in spans:
                for id, start, end in self.marks(span["file_name"], opening, closing):
                    if (
                        start <= span["byte_start"]
                        and span["byte_end"] <= end
                        and (best is None or end - start < best[0])
                    ):
                        best = (end - start, id)
            if best is not None:
                return [best[1]]
        return []

    def arm_below(self, error: dict[str, Any]) -> list[int]:
        """The first arm with a switch below a match that its guard leaves incomplete."""
        if "non-exhaustive" not in error["message"]:
            return []
        span = error["spans"][0]
        below = (self.tree / span["file_name"]).read_bytes()[span["byte_end"] :].decode()
        ids = (int(m[1]) for m in re.finditer(r"::mutant\((\d+)\)", below))
        return [id for id in ids if self.mutants[id].genre == "MatchArm"][:1]

    def marks(self, name: str, opening: str, closing: str) -> list[tuple[int, int, int]]:
        key = (name, opening)
        if key not in self.found:
            source = (self.tree / name).read_bytes()
            ends = {
                int(m[1]): m.start() for m in re.finditer(rb"/\*(\d+)" + re.escape(closing.encode()) + rb"\*/", source)
            }
            marks = re.finditer(rb"/\*" + re.escape(opening.encode()) + rb"(\d+)\*/", source)
            self.found[key] = [(int(m[1]), m.start(), ends[int(m[1])]) for m in marks]
        return self.found[key]

    def programs(self) -> list[Test]:
        """Builds the tests of the packages and lists them."""
        tests = []
        for message in self.cargo(
            "test", "--release", "--no-run", "--quiet", "--lib", "--bins", "--tests", *self.packages
        ):
            if message.get("reason") == "compiler-message" and message["message"]["level"] == "error":
                sys.exit(message["message"]["rendered"])
            if message.get("reason") == "compiler-artifact" and message["profile"]["test"] and message["executable"]:
                folder = str(Path(message["manifest_path"]).parent)
                shown = subprocess.run(
                    [message["executable"], "--list", "--format=terse"],
                    check=True,
                    cwd=folder,
                    stdout=subprocess.PIPE,
                    text=True,
                )
                names = [line.removesuffix(": test") for line in shown.stdout.splitlines() if line.endswith(": test")]
                tests += [Test(message["executable"], folder, name) for name in names]
        return tests


def run(test: Test, limit: float, variables: dict[str, str]) -> bool | None:
    """Runs one test alone: whether it passed, or None if it took longer than `limit` seconds."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        environment = (
            os.environ
            | variables
            | {
                "TMPDIR": folder,
                "CARGO_MANIFEST_DIR": test.folder,
                "PROPTEST_RNG_SEED": "1",
                "PROPTEST_CASES": "32",
                "PROPTEST_MAX_SHRINK_ITERS": "0",
                "PROPTEST_DISABLE_FAILURE_PERSISTENCE": "1",
            }
        )
        # `timeout` ends the test even if this program is killed.
        process = subprocess.Popen(
            ["timeout", "--signal=KILL", f"{limit:.1f}"]
            + [test.program, "--exact", test.name, "--include-ignored", "--test-threads=1", "--quiet"],
            cwd=test.folder,
            env=environment,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        code = process.wait()
        # Ends processes that the test started and left.
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        return None if code in (-signal.SIGKILL, 128 + signal.SIGKILL) else code == 0


def noted(tests: list[Test], path: Path, count: int, workers: ThreadPoolExecutor) -> list[Test]:
    """The tests that pass on the code as written, with what they pass, kept in a file for runs with the same programs."""
    programs = {test.program: Path(test.program).stat().st_mtime_ns for test in tests}
    if path.exists():
        kept = json.loads(path.read_text())
        if kept["programs"] == programs:
            return [
                Test(program, folder, name, seconds, set(passes))
                for program, folder, name, seconds, passes in kept["tests"]
            ]
    passed = list(workers.map(lambda test: note(test, count), tests))
    for test, good in zip(tests, passed, strict=True):
        if not good:
            print(f"left out: {test.name} ({test.seconds:.1f} s)")
    tests = [test for test, good in zip(tests, passed, strict=True) if good]
    values = [(test.program, test.folder, test.name, test.seconds, sorted(test.passes)) for test in tests]
    path.write_text(json.dumps({"programs": programs, "tests": values}))
    return tests


def note(test: Test, count: int) -> bool:
    """Runs a test without a mutant and notes its time and the mutants that it passes; False if it fails or takes too long."""
    with tempfile.NamedTemporaryFile(prefix="mutants-") as seen:
        started = time.monotonic()
        passed = run(test, LONGEST_S, {"SLICEWALK_MUTANTS_SEEN": seen.name})
        test.seconds = time.monotonic() - started
        content = Path(seen.name).read_bytes()[:count]
        test.passes = {number for number, byte in enumerate(content) if byte}
        return passed is True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tests", type=float, default=LONGEST_S, help="leave out tests that take longer (s)")
    parser.add_argument("--each", type=float, default=float("inf"), help="leave a mutant after so long (s): `left`")
    parser.add_argument("--only", default="", help="mutants whose path or name holds this")
    parser.add_argument("--packages", nargs="+", default=["slicewalk", "slicewalk-base", "sliceconv"])
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)

    mutants = listed()
    build = Build(folder, mutants, options.packages)
    build.settle()
    tests = build.programs()
    print(f"{len(mutants)} mutants, {len(tests)} tests", flush=True)

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    workers = ThreadPoolExecutor(os.cpu_count())
    tests = [
        test
        for test in noted(tests, folder / "notes.json", len(mutants), workers)
        if test.passes and test.seconds <= options.tests
    ]
    reaching: dict[int, list[Test]] = defaultdict(list)
    for test in tests:
        for number in test.passes:
            reaching[number].append(test)
    print(f"{len(tests)} tests pass mutants, in {sum(test.seconds for test in tests):.0f} s", flush=True)

    path = folder / "results.tsv"
    known = {line.split("\t")[1] for line in path.read_text().splitlines()} if path.exists() else set()
    results = path.open("a")
    lock = threading.Lock()
    # Tries and successes of each test with mutants of a file or a function: the cheapest hope comes first.
    tries: Counter[tuple[Test, str]] = Counter()
    kills: Counter[tuple[Test, str]] = Counter()

    def cost(test: Test, mutant: Mutant) -> float:
        hope = (kills[test, mutant.file] + 1) / (tries[test, mutant.file] + 2) * (1 + 5 * kills[test, mutant.function])
        return (test.seconds + 0.03) / hope

    def judge(mutant: Mutant) -> None:
        state, by = mutant.state, ""
        if state == "not built":
            state = "missed" if reaching[mutant.id] else "not passed"
            started = time.monotonic()
            for test in sorted(reaching[mutant.id], key=lambda test: cost(test, mutant)):
                if time.monotonic() - started > options.each:
                    state = "left"
                    break
                passed = run(test, 5 * test.seconds + 3, {"SLICEWALK_MUTANT": str(mutant.id)})
                tries[test, mutant.file] += 1
                if passed is not True:
                    kills.update([(test, mutant.file), (test, mutant.function)])
                    state, by = ("caught" if passed is False else "too slow"), test.name
                    break
        with lock:
            results.write(f"{state}\t{mutant.name}\t{by}\n")
            results.flush()

    chosen = [m for m in mutants if options.only in m.name and m.name not in known]
    chosen.sort(key=lambda mutant: list(PARTS).index(part_of(mutant.name)))
    try:
        for done, _ in enumerate(workers.map(judge, chosen), 1):
            if done % 100 == 0:
                print(f"{done} of {len(chosen)}", flush=True)
    except KeyboardInterrupt:
        workers.shutdown(wait=False, cancel_futures=True)
        sys.exit("interrupted; the next run continues")
    summary(path, mutants)


def part_of(name: str) -> str:
    return next(part for part, prefix in PARTS.items() if name.startswith(prefix))


def reason(mutant: Mutant, line: str, reasons: dict[str, str]) -> str | None:
    """The key of the reason that fits a mutant, if any."""
    for key in reasons:
        function, _, words = key.partition(": ")
        if function == re.split(r"[ :]", mutant.function)[-1] and all(w in line or w in mutant.name for w in words.split("; ")):
            return key
    return None


def summary(path: Path, mutants: list[Mutant]) -> None:
    """Prints what became of the mutants of each part, and lists those that were not noticed and have no reason."""
    by_name = {mutant.name: mutant for mutant in mutants}
    reasons = tomllib.loads((ROOT / "tools/mutants.toml").read_text())
    unfit = {(file, key) for file, of_file in reasons.items() for key in of_file}
    states: dict[str, Counter[str]] = defaultdict(Counter)
    survivors = []
    for entry in path.read_text().splitlines():
        state, name, _ = entry.split("\t")
        mutant = by_name[name]
        if state in ("missed", "not passed", "left"):
            source = (ROOT / mutant.file).read_bytes()
            line = source[source.rfind(b"\n", 0, mutant.start) + 1 :].split(b"\n", 1)[0].decode()
            key = reason(mutant, line, reasons.get(mutant.file, {}))
            if key is None:
                survivors.append(f"{state}: {name}: {line.strip()}")
            else:
                unfit.discard((mutant.file, key))
                state += ", with a reason"
        states[part_of(name)][state] += 1
        states["all"][state] += 1
    for part, counts in states.items():
        noticed = counts["caught"] + counts["too slow"]
        built = sum(counts.values()) - counts["does not compile"] - counts["not switchable"]
        explained = sum(count for state, count in counts.items() if state.endswith("reason"))
        shares = f"{100 * noticed / max(built, 1):.1f} % noticed, {100 * explained / max(built, 1):.1f} % have a reason"
        print(f"{part}: {noticed} of {built}, {shares};", dict(counts))
    fits_nothing = [f"fits nothing: {file}: {key}" for file, key in sorted(unfit)]
    path.with_name("survivors.txt").write_text("".join(f"{line}\n" for line in survivors + fits_nothing))


if __name__ == "__main__":
    main()
