"""Give fl3d malformed words, configs and files, and see that each is answered in one sentence.

    python -m tests.campaigns.malformed --seed 0
    python -m tests.campaigns.malformed --only words files:database   # all words; files whose case is of a database

The answer to a mistake has exit code 2 (1 where a stage failed on it), no traceback, a few lines, and names what is
wrong: the key of a word, the file that was spoilt. Files that fl3d can make again may be mended without a word.
"""

from __future__ import annotations

import random
import shutil
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.campaigns.malformed_files import FILES, Spoilt
from tests.campaigns.malformed_words import CONFIGS, WORDS
from tests.campaigns.parts import SMALL, share
from tests.campaigns.runner import Asked, Found, main
from tests.campaigns.starts import Start, descendants, kill, load

SECONDS = 120.0  # a case may take, on a machine that does much else
LINES = 12  # of an answer: a sentence, perhaps a list of what was possible
ERRORS = ("fl3d: ", "usage: ", "python -m fl3d")


@dataclass(frozen=True)
class Case:
    """Something malformed.

    Args:
        name: of it.
        words: behind ``python -m fl3d``.
        names: one of these is in the answer.
        codes: exit codes that will do.
    """

    name: str
    words: list[str]
    names: tuple[str, ...]
    codes: tuple[int, ...] = (2,)


def judge(case: Case, work: Path, found: Found) -> str:
    """Run a case; what it came to, in a word."""
    start = Start(case.words, work / "log.txt")
    if not start.wait(SECONDS):
        kill([start.pid, *descendants(start.pid)])
        start.wait(10)
        found.check(False, f"{case.name}: no answer within {SECONDS:.0f} s: {' '.join(case.words)}")
        return "no answer"
    said = start.said()
    shown = f"{case.name}: code {start.code}: {said[-700:]}"
    if "Traceback (most recent call last)" in said:
        found.check(False, f"{case.name}: a traceback, code {start.code}: {_last(said)}")
        return "traceback"
    if start.code not in case.codes:
        found.check(False, shown)
        return "accepted" if start.code == 0 else "other code"
    if start.code == 0:
        return "mended"
    answer = _answer(said)
    if len(answer.splitlines()) > LINES and case.words[0] != "check":  # that is a report
        found.check(False, f"{case.name}: {len(answer.splitlines())} lines: {answer[:300]}")
        return "long"
    if case.names and not any(name in answer for name in case.names):
        found.check(False, f"{case.name}: names none of {case.names}: {answer[-400:]}")
        return "unnamed"
    return "answered"


def _answer(said: str) -> str:
    """What was said from the error on."""
    places = [said.rfind(f"\n{word}") for word in ERRORS]
    return said[max(0, *places) :].strip()


def _last(said: str) -> str:
    return said.strip().splitlines()[-1][:300]


def words_cases(shared: Path, work: Path) -> list[Case]:
    """Malformed words of the command line."""
    places = [f"store.root={work / 'runs'}", f"results={work / 'results'}", "hydra/launcher=inline"]
    small = [word.format(shared=shared, work=work) for word in SMALL]
    cases = []
    for text, names in WORDS:
        words = text if isinstance(text, list) else text.split()
        places_of = {"{shared}": str(shared), "{work}": str(work)}
        for place, path in places_of.items():
            words = [word.replace(place, path) for word in words]
        filled: list[str] = []
        for word in words:
            filled += ["detector=fcn3d", *small, *places] if word == "SMALL" else [word]
        keys = tuple(names) if not isinstance(names, str) else (names,)
        cases.append(Case(f"words {' '.join(words)[:80]}", filled, keys, (2,)))
    return cases


def config_cases(shared: Path, work: Path) -> list[Case]:
    """Malformed sweep files and detectors of the user's own."""
    places = [f"store.root={work / 'runs'}", f"results={work / 'results'}", "hydra/launcher=inline"]
    small = [word.format(shared=shared, work=work) for word in SMALL]
    cases = []
    for number, (group, text) in enumerate(CONFIGS):
        folder = work / "configs" / f"{number}" / group
        folder.mkdir(parents=True, exist_ok=True)
        name = f"odd{number}"
        content = text if isinstance(text, bytes) else text.encode()
        (folder / f"{name}.yaml").write_bytes(content)
        choice = f"+sweep={name}" if group == "sweep" else f"detector={name}"
        words = ["-m", "--config-dir", str(folder.parent), choice, *small, *places]
        cases.append(Case(f"config {group} {text[:60]!r}", words, (), (2,)))
    return cases


def campaign(asked: Asked) -> Found:
    """All cases, or as many as are asked for, chosen at random."""
    load()
    found = Found()
    shared = asked.work / "shared"
    if not shared.exists():
        share(shared)
    rng = random.Random(asked.seed)
    words = asked.work / "words"
    words.mkdir(exist_ok=True)
    kinds: dict[str, list[Case | Spoilt]] = {
        "words": [*words_cases(shared, words)],
        "configs": [*config_cases(shared, words)],
        "files": [*FILES],
    }
    files = Files(asked.work, shared)
    for kind, cases in kinds.items():
        if asked.only:
            parts = [one.partition(":")[2] for one in asked.only if one.split(":")[0] == kind]
            cases = [case for case in cases if any(part in case.name for part in parts)]
        chosen = cases if asked.count >= len(cases) else rng.sample(cases, asked.count)
        results: Counter[str] = Counter()
        for case in chosen:
            if isinstance(case, Spoilt):
                result = files.judge(case, found)
            else:
                result = judge(case, words, found)
                for name in ("runs", "results"):
                    shutil.rmtree(words / name, ignore_errors=True)
            results[result] += 1
        told = ", ".join(f"{number} {result}" for result, number in sorted(results.items()))
        found.figures.append(f"{kind}: {len(chosen)} cases: {told}")
    return found


class Files:
    """Spoils copies of a finished sweep and its data, one file a case."""

    def __init__(self, work: Path, shared: Path) -> None:
        self.work, self.shared = work, shared
        self.whole = work / "finished"

    def judge(self, case: Spoilt, found: Found) -> str:
        """Spoil a file of a fresh copy, and see what a command says of it."""
        if not self.whole.exists():
            self._train()
        copy = self.work / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(self.whole, copy, symlinks=True)
        path = case.spoil(copy)
        words = [
            word.replace("COPY", str(copy)).replace("SPOILT", str(path)) for word in case.words
        ]
        names = (path.name, path.stem, *case.names)
        name = f"file {case.name}"
        return judge(Case(name, words, names, case.codes), self.work, found)

    def _train(self) -> None:
        """A grid, a study, and data beside them, all in one folder."""
        made = self.work / "copy"
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir()
        shutil.copytree(self.shared / "data", made / "data")
        shutil.copytree(self.shared / "exp", made / "exp")
        for words in (GRID, STUDY):
            start = Start(
                [word.replace("COPY", str(made)) for word in words], self.work / "log.txt"
            )
            if not start.wait(900) or start.code:
                raise RuntimeError(start.said())
        made.rename(self.whole)


def _small(sweep: str) -> list[str]:
    small = [word.replace("{shared}", "COPY") for word in SMALL]
    return [*small, "store.root=COPY/runs", "results=COPY/results", f"sweep.name={sweep}"]


INLINE = "hydra/launcher=inline"
GRID = ["-m", "detector=fcn3d", "loss.gamma=0,2", INLINE, *_small("grid")]
STUDY = [
    *("-m", "detector=fcn3d", "hydra/sweeper=optuna", "loss.gamma=choice(0,2)", INLINE),
    *("hydra.sweeper.n_trials=2", *_small("search")),
]


if __name__ == "__main__":
    main(campaign, __doc__, 1000)
