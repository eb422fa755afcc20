"""Settings: what an organiser may decide, and how a mistake is told with its key."""

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from pydantic import BaseModel
from sqlalchemy import make_url

from reverie_eval.schemas.service import Phase, Schedule
from reverie_eval.server.operations.checks import check_folder, check_sound
from reverie_eval.server.settings import (
    SETTINGS_FILE,
    BoardRules,
    Limits,
    Metadata,
    Quota,
    Settings,
    SettingsError,
    Split,
    Webhook,
    load_settings,
)
from tests.conftest import REPOSITORY
from tests.support.acting import NOON
from tests.support.flat_world import Run
from tests.support.processes import Laptop
from tests.support.serving import (
    GOOD,
    OPEN,
    OWNER,
    OpenServer,
    adjusted,
    rename_dataset,
    settings_of,
)

REFERENCE = (REPOSITORY / "docs" / "reference" / "server-settings.md").read_text()
ALL_SETTINGS = re.findall(r"^\| `([\w.]+)` \| .* \| .* \|$", REFERENCE, re.MULTILINE)
"""Another test holds that the reference has all of them."""
SPLIT = '[splits.test]\nbundle = "bundles/test.npz"\n'


def unknown(key: str, section: type[BaseModel] = Settings, guess: str = "") -> str:
    """Return what is said of an unknown setting."""
    hint = f"did you mean {guess}? Choose" if guess else "choose"
    return f"{key}: is not a setting; {hint} one of: {', '.join(section.model_fields)}"


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in os.environ:
        if name.startswith("REVERIE_EVAL_"):
            monkeypatch.delenv(name)


def loaded(folder: Path, text: str = SPLIT) -> Settings:
    (folder / SETTINGS_FILE).write_text(text, encoding="utf-8")
    return load_settings(folder)


def problems(folder: Path, text: str) -> Sequence[str]:
    with pytest.raises(SettingsError) as rejected:
        loaded(folder, text)
    return [f"{problem.where}: {problem.message}" for problem in rejected.value.problems]


def test_one_split_is_enough(tmp_path: Path) -> None:
    settings = loaded(tmp_path)
    assert settings.folder == tmp_path.resolve()
    assert settings.path(settings.splits["test"].bundle) == tmp_path.resolve() / "bundles/test.npz"
    assert settings.splits["test"] == Split(
        bundle=Path("bundles/test.npz"),
        visibility="private",
        protocol="official-v1",
        quota=None,
        phases=(Phase(name="always"),),
    )
    assert settings.required_metadata == ()


def test_a_check_shows_where_uploads_are_stored(folder: Path) -> None:
    (found,) = [each for each in check_folder(folder) if each.check == "uploads"]
    assert (found.kind, found.what) == ("ok", str(folder.resolve() / "uploads"))


def test_the_template_is_sound_and_says_what_would_be_anyway(folder: Path) -> None:
    template = load_settings(folder)
    assert list(template.splits) == ["test", "val_seen", "val_unseen"]
    assert template.splits["test"].quota == Quota()
    for name, field in Settings.model_fields.items():
        if name != "splits":
            assert getattr(template, name) == field.default, name


@pytest.mark.parametrize("setting", ALL_SETTINGS)
def test_the_template_names_every_setting(setting: str, folder: Path) -> None:
    """In its section, with a value, or in a table that is written in one line."""
    text = (folder / SETTINGS_FILE).read_text()
    first, *sections = re.split(r"^(?:# )?\[(?=[a-z])", text, flags=re.MULTILINE)
    section, _, name = setting.rpartition(".")
    begins = section.partition(".")[0] or name
    own = [each for each in sections if re.match(rf"{begins}[].]", each)]
    text = own[0] if own else first
    assert re.search(rf"^(# )?{name} = |[{{,] {name} = |^{name}\]", text, re.MULTILINE)


def test_what_the_template_has_as_a_comment_is_a_setting(folder: Path, tmp_path: Path) -> None:
    text = (folder / SETTINGS_FILE).read_text()
    example = re.compile(r"^# (?=\[[a-z]+\]$|[A-Za-z_]+ = )", re.MULTILINE)
    lines: dict[tuple[str, str], str] = {}
    section = ""
    for line in example.sub("", text).splitlines():
        section = line if line.startswith("[") else section
        lines[section, line.partition(" = ")[0]] = line  # of two examples, the last one
    told = problems(tmp_path, "\n".join(lines.values()))
    assert [each for each in told if "is not a setting" in each] == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        pytest.param(f"titel = 'x'\n{SPLIT}", [unknown("titel", guess="title")], id="unknown"),
        pytest.param(
            f"{SPLIT}quotas = {{}}\n",
            [unknown("splits.test.quotas", Split, "quota")],
            id="unknown in a split",
        ),
        pytest.param(
            f"{SPLIT}quota = {{ week = 3 }}\n",
            [unknown("splits.test.quota.week", Quota)],
            id="unknown window",
        ),
        pytest.param(
            f"{SPLIT}phases = [{{ name = 'a', closed = 2027-01-01T00:00:00Z }}]\n",
            [unknown("splits.test.phases.0.closed", Phase, "closes")],
            id="unknown in a phase",
        ),
        pytest.param(
            f"{SPLIT}boards.strict.protocoll = 'paper'\n",
            [unknown("splits.test.boards.strict.protocoll", BoardRules, "protocol")],
            id="unknown in another leaderboard",
        ),
        pytest.param(
            f"{SPLIT}[limits]\nupload_megabytes = 1\n",
            [unknown("limits.upload_megabytes", Limits, "upload_mebibytes")],
            id="unknown limit",
        ),
        pytest.param(
            f"{SPLIT}[webhook]\nurl = 'https://example.org'\nevent = []\n",
            [unknown("webhook.event", Webhook, "events")],
            id="unknown in an optional section",
        ),
        pytest.param(f"folder = '/'\n{SPLIT}", [unknown("folder")], id="the folder"),
        pytest.param(f"_env_file = 'x'\n{SPLIT}", [unknown("_env_file")], id="the library's own"),
        pytest.param("title = 'x'\n", ["splits: required but missing"], id="no split"),
        pytest.param(
            "splits = 3\n",
            ["splits: got 3; must be a table"],
            id="splits are none",
        ),
        pytest.param(
            f"{SPLIT}boards = {{ strict = 'paper' }}\nphases = [3]\n",
            [
                "splits.test.phases.0: got 3; must be a table",
                "splits.test.boards.strict: got 'paper'; must be a table",
            ],
            id="no tables",
        ),
        pytest.param(
            f"{SPLIT}phases = 'always'\n[splits.other]\nbundle = []\n",
            [
                "splits.test.phases: got 'always'; must be a list",
                "splits.other.bundle: must be a path",
            ],
            id="neither a list nor a path",
        ),
        pytest.param(
            f"{SPLIT}boards = {{ Strict = {{ protocol = 'paper' }} }}\n",
            [
                (
                    "splits.test.boards.Strict: 'Strict' must have up to 40 lower-case letters, "
                    "digits, - and _, and begin with a letter"
                )
            ],
            id="a leaderboard's name",
        ),
        pytest.param(
            "[splits]\n",
            ["splits: must have 1 or more entries"],
            id="empty splits",
        ),
        pytest.param(
            "[splits.test]\n", ["splits.test.bundle: required but missing"], id="no bundle"
        ),
        pytest.param(
            f"{SPLIT}visibility = 'secret'\n",
            ["splits.test.visibility: got 'secret'; must be 'private' or 'open'"],
            id="visibility",
        ),
        pytest.param(
            f"{SPLIT}quota = {{ day = -1 }}\n",
            ["splits.test.quota.day: got -1; must be 0 or more"],
            id="negative quota",
        ),
        pytest.param(
            f"{SPLIT}quota = {{ day = 2.5 }}\n",
            ["splits.test.quota.day: got 2.5; must be a whole number"],
            id="half a submission",
        ),
        pytest.param(
            f"{SPLIT}phases = [{{ name = '' }}]\n",
            ["splits.test.phases.0.name: got ''; must have 1 or more characters"],
            id="nameless phase",
        ),
        pytest.param(
            f"{SPLIT}phases = []\n",
            [
                (
                    "splits.test.phases: add a phase, or leave phases out to accept submissions "
                    "at any time"
                )
            ],
            id="no phase",
        ),
        pytest.param(
            f"{SPLIT}phases = [{{ name = 'a', opens = 2027-01-01T00:00:00 }}]\n",
            [
                (
                    "splits.test.phases.0.opens: must be a time with its time zone, such as "
                    "2027-06-01T12:00:00Z"
                )
            ],
            id="a time without a zone",
        ),
        pytest.param(
            f"{SPLIT}phases = [{{ name = 'a', opens = 2027-01-02T00:00:00Z, "
            "closes = 2027-01-02T00:00:00Z }]\n",
            ["splits.test.phases.0: a phase must open before it closes"],
            id="closes as it opens",
        ),
        pytest.param(
            f"{SPLIT}phases = [{{ name = 'always' }}, {{ name = 'a', opens = 2027-01-02 }}]\n",
            [
                (
                    "splits.test: the phases 'always' (always open) and 'a' (from "
                    "2027-01-02T00:00:00Z) overlap; 'always' must close before 'a' opens"
                )
            ],
            id="phases overlap",
        ),
        pytest.param(
            f"{SPLIT}[limits]\nupload_mebibytes = 0\n",
            ["limits.upload_mebibytes: got 0; must be more than 0"],
            id="no bytes",
        ),
        pytest.param(
            f"banner = 'Hello'\npaused = true\n{SPLIT}paused = true\n",
            [
                "banner: is not a setting; remove it, and use `reverie-eval server news banner`",
                "paused: is not a setting; remove it, and use `reverie-eval server phase pause`",
                (
                    "splits.test.paused: is not a setting; remove it, and use `reverie-eval server "
                    "phase pause`"
                ),
            ],
            id="what commands set",
        ),
        pytest.param(
            f"title = ''\n{SPLIT}",
            ["title: got ''; must have 1 or more characters"],
            id="no title",
        ),
        pytest.param(
            f'title = "a\\u001b[31mb"\norganiser = "c\\nd"\n{SPLIT}',
            [
                "title: got 'a\\x1b[31mb'; must be one line without invisible characters",
                "organiser: got 'c\\nd'; must be one line without invisible characters",
            ],
            id="what cannot be seen, and two lines",
        ),
        pytest.param(
            f"required_metadata = ['hair']\n{SPLIT}",
            [
                (
                    "required_metadata.0: got 'hair'; must be 'description', 'paper', "
                    "'code', 'extra_data', 'pre_exploration', 'ground_truth_objects' or 'ensemble'"
                )
            ],
            id="unknown metadata",
        ),
        pytest.param(
            f"database = 5\norganiser = 3\nx = 1\n{SPLIT}",
            [
                "database: must be text",
                "organiser: got 3; must be text",
                unknown("x"),
            ],
            id="everything at once, and no database's address",
        ),
    ],
)
def test_a_wrong_setting_is_told_with_its_key(
    text: str, found: Sequence[str], tmp_path: Path
) -> None:
    assert sorted(problems(tmp_path, text)) == sorted(found)


def test_an_unknown_protocol_is_told_with_those_that_are_known(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path, f"{SPLIT}protocol = 'offical-v1'\n")
    assert problem.startswith(
        "splits.test.protocol: unknown protocol 'offical-v1'; did you mean official-v1? "
    )


def test_an_alias_of_a_protocol_is_what_it_stands_for(tmp_path: Path) -> None:
    assert loaded(tmp_path, f"{SPLIT}protocol = 'hamt'\n").splits["test"].protocol == "duet"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(b"title = ", "Invalid value (at end of document)", id="no TOML"),
        pytest.param(b"a = 1\na = 2\n", "Cannot overwrite a value", id="twice"),
        pytest.param(b"title = '\xff'", "invalid UTF-8 from byte 9 on; restore it", id="no UTF-8"),
    ],
)
def test_what_is_no_toml_is_told_with_its_place(
    content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / SETTINGS_FILE).write_bytes(content)
    with pytest.raises(SettingsError) as rejected:
        load_settings(tmp_path)
    (problem,) = rejected.value.problems
    assert problem.where == str(tmp_path / SETTINGS_FILE)
    assert message in problem.message


def test_a_folder_without_settings_is_told_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=f"create one with `reverie-eval server init {tmp_path}`"
    ):
        load_settings(tmp_path)


def test_settings_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / SETTINGS_FILE).mkdir()
    with pytest.raises(SettingsError, match="Is a directory"):
        load_settings(tmp_path)


# Variables.


def test_variables_win_over_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REVERIE_EVAL_TITLE", "Theirs")
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", "postgresql+psycopg://me:word@host/name")
    monkeypatch.setenv("REVERIE_EVAL_SPLITS__test__protocol", "r2r-style")
    monkeypatch.setenv("REVERIE_EVAL_SPLITS__test__quota__day", "7")
    monkeypatch.setenv("REVERIE_EVAL_ACCEPT_REQUESTS_TO_JOIN", "false")
    content = f"title = 'Ours'\norganiser = 'Us'\n{SPLIT}quota = {{ month = 9 }}\n"
    settings = loaded(tmp_path, content)
    assert (settings.title, settings.organiser) == ("Theirs", "Us")
    assert not settings.accept_requests_to_join
    assert settings.database_url == make_url("postgresql+psycopg://me:word@host/name")
    assert settings.splits["test"].protocol == "r2r-style"
    assert settings.splits["test"].effective_quota == Quota(day=7, month=9, year=40)
    assert settings.splits["test"].bundle == Path("bundles/test.npz")


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        (
            "SPLITS__test__quota__day",
            "many",
            "splits.test.quota.day: got 'many'; must be a whole number",
        ),
        ("LIMITS__SECONDS", "3", "limits.seconds: is not a setting"),
        ("SPLITS", "{", 'REVERIE_EVAL_: error parsing value for field "splits"'),
        ("SPLITS__val__visibility", "open", "splits.val.bundle: required but missing"),
    ],
)
def test_a_wrong_variable_is_told(
    name: str, value: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"REVERIE_EVAL_{name}", value)
    (problem,) = problems(tmp_path, SPLIT)
    assert problem.startswith(found)


@pytest.mark.parametrize("name", ["FOLDER", "_FOLDER", "TOKEN", "GROUND_TRUTH", "SERVER"])
def test_variables_that_are_no_settings_change_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"REVERIE_EVAL_{name}", "/elsewhere")
    assert loaded(tmp_path).folder == tmp_path.resolve()


def test_a_misspelt_variable_is_noted_and_that_of_another_program_is_no_fault(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_DATBASE", "postgresql+psycopg://me:word@host/name")
    monkeypatch.setenv("REVERIE_EVAL_PORT_80_TCP", "tcp://10.0.0.1:80")
    monkeypatch.setenv("REVERIE_EVAL_TITLE", "Ours")
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", "rv_mine")
    said: list[str] = []
    assert check_sound(folder, said.append).title == "Ours"
    assert said == [
        "the environment variable REVERIE_EVAL_DATBASE is not a setting; check its spelling",
        "the environment variable REVERIE_EVAL_PORT_80_TCP is not a setting; check its spelling",
    ]


@pytest.mark.parametrize(
    ("database", "url"),
    [
        ("sqlite:///server.db", "sqlite:///{folder}/server.db"),
        ("sqlite:////var/server.db", "sqlite:////var/server.db"),
        ("postgresql+psycopg://host/name", "postgresql+psycopg://host/name"),
    ],
)
def test_sqlites_file_is_below_the_folder(database: str, url: str, tmp_path: Path) -> None:
    settings = loaded(tmp_path, f"database = '{database}'\n{SPLIT}")
    assert settings.database_url == make_url(url.format(folder=tmp_path.resolve()))


DATABASES = (
    "database: must be an SQLite file, sqlite:///FILE, or PostgreSQL, "
    "postgresql+psycopg://USER:PASSWORD@HOST/NAME"
)
BEFORE = (
    "database: user and password must come before the @: "
    "postgresql+psycopg://USER:PASSWORD@HOST/NAME"
)


@pytest.mark.parametrize(
    ("database", "told"),
    [
        pytest.param("server.db", DATABASES, id="a name alone"),
        pytest.param("sqlite://", DATABASES, id="memory"),
        pytest.param("sqlite:///", DATABASES, id="no name"),
        pytest.param("sqlite:///:memory:", DATABASES, id="memory by its name"),
        pytest.param("sqlite://server.db", DATABASES, id="a host for a file"),
        pytest.param("sqlite:///a?b.db", DATABASES, id="a query for a file"),
        pytest.param("mysql://me@host/name", DATABASES, id="another kind"),
        pytest.param("postgresql://me@host/name", DATABASES, id="a driver we do not install"),
        pytest.param("postgresql+psycopg://me@host:abc/name", DATABASES, id="no port"),
        pytest.param("postgresql+psycopg://host/name?password=word", BEFORE, id="password behind"),
        pytest.param("postgresql+psycopg://host/name?user=me", BEFORE, id="user behind"),
    ],
)
def test_what_is_no_database_is_told_with_what_is(database: str, told: str, tmp_path: Path) -> None:
    assert problems(tmp_path, f"database = '{database}'\n{SPLIT}") == [told]


@pytest.mark.parametrize(
    ("uploads", "told"),
    [
        pytest.param("gs://bucket", "must be a folder, or an S3-compatible", id="another store"),
        pytest.param("s3://", "s3://BUCKET/PREFIX", id="no bucket"),
        pytest.param("s3:bucket", "s3://BUCKET/PREFIX", id="no address"),
        pytest.param("", "is the server's folder or contains it", id="the folder itself"),
        pytest.param(
            "uploads/..", "is the server's folder or contains it", id="the folder, roundabout"
        ),
        pytest.param("/", "is the server's folder or contains it", id="around the folder"),
    ],
)
def test_what_is_no_place_for_uploads_is_told_with_what_is(
    uploads: str, told: str, tmp_path: Path
) -> None:
    (problem,) = problems(tmp_path, f"uploads = '{uploads}'\n{SPLIT}")
    assert problem.startswith("uploads: ")
    assert told in problem


@pytest.mark.parametrize("uploads", ["kept/uploads", "../beside", "s3://bucket", "s3://b/a/b"])
def test_where_uploads_may_be(uploads: str, tmp_path: Path) -> None:
    assert loaded(tmp_path, f"uploads = '{uploads}'\n{SPLIT}").uploads == uploads


# What the settings come to.


@pytest.mark.parametrize(
    ("visibility", "quota", "effective"),
    [
        ("private", None, (2, 10, 40)),
        ("open", None, (200, 2000, 10000)),
        ("private", {"day": 1}, (1, 10, 40)),
        ("open", {"day": 500}, (500, 2000, 10000)),
        ("open", {"day": 2, "month": 10, "year": 40}, (2, 10, 40)),
        ("private", {"year": 0}, (2, 10, 0)),
    ],
)
def test_what_of_a_quota_is_not_set_is_the_visibilitys(
    visibility: str, quota: dict[str, int] | None, effective: tuple[int, int, int]
) -> None:
    split = Split.model_validate({"bundle": "x", "visibility": visibility, "quota": quota})
    found = split.effective_quota
    assert (found.day, found.month, found.year) == effective


HOUR = timedelta(hours=1)
PAST = NOON - timedelta(seconds=1)


@pytest.mark.parametrize(
    ("opens", "closes", "is_open"),
    [
        pytest.param(None, None, True, id="always"),
        pytest.param(NOON, None, True, id="opens now"),
        pytest.param(NOON + timedelta(microseconds=1), None, False, id="opens in a moment"),
        pytest.param(None, NOON, True, id="closes with this second"),
        pytest.param(None, NOON - timedelta(microseconds=1), False, id="closed with the last one"),
        pytest.param(None, datetime(2999, 12, 31, tzinfo=UTC), True, id="closes in an age"),
        pytest.param(NOON - HOUR, NOON + HOUR, True, id="in its midst"),
        pytest.param(NOON - 2 * HOUR, NOON - HOUR, False, id="over"),
    ],
)
def test_when_a_phase_is_open(
    opens: datetime | None, closes: datetime | None, *, is_open: bool
) -> None:
    assert Phase(name="a", opens=opens, closes=closes).is_open(NOON) is is_open


@pytest.mark.parametrize(
    ("ends", "closes_at"),
    [
        pytest.param([NOON + HOUR, NOON + 2 * HOUR], NOON + 2 * HOUR, id="with the last one"),
        pytest.param([NOON + 2 * HOUR, NOON + HOUR], NOON + 2 * HOUR, id="in any order"),
        pytest.param([PAST, NOON + HOUR], NOON + HOUR, id="not with one that is over"),
        pytest.param([NOON + HOUR, None], None, id="never"),
        pytest.param([PAST], None, id="it is closed"),
    ],
)
def test_when_a_split_closes(ends: Sequence[datetime | None], closes_at: datetime | None) -> None:
    phases = [Phase(name=f"phase {number}", closes=end) for number, end in enumerate(ends)]
    assert Schedule(phases=tuple(phases)).closes_at(NOON) == closes_at


@pytest.mark.parametrize(
    ("moment", "is_open"),
    [
        pytest.param("2027-06-01T22:59:58.999999Z", False, id="before its first second"),
        pytest.param("2027-06-01T22:59:59Z", True, id="its first second"),
        pytest.param("2027-06-01T23:59:59Z", True, id="its last second"),
        pytest.param("2027-06-01T23:59:59.999999Z", True, id="the end of it"),
        pytest.param("2027-06-02T00:00:00Z", False, id="the next"),
    ],
)
def test_a_phase_closes_with_the_end_of_a_second(moment: str, *, is_open: bool) -> None:
    last = datetime(2027, 6, 1, 23, 59, 59, tzinfo=UTC)
    phase = Phase(name="a", opens=last - HOUR, closes=last)
    assert phase.is_open(datetime.fromisoformat(moment)) is is_open


@pytest.mark.parametrize(
    ("phases", "status", "message"),
    [
        pytest.param((), 409, "accepts no submissions now", id="never"),
        pytest.param((Phase(name="a", closes=PAST),), 409, "accepts no submissions now", id="over"),
        pytest.param(
            (Phase(name="a", closes=PAST), Phase(name="b", opens=NOON + HOUR)),
            409,
            "the next phase opens 2026-03-02T13:00:00+00:00",
            id="between two",
        ),
        pytest.param(
            (Phase(name="a", opens=NOON + 2 * HOUR), Phase(name="b", opens=NOON + HOUR)),
            409,
            "the next phase opens 2026-03-02T13:00:00+00:00",
            id="before two",
        ),
        pytest.param(
            (Phase(name="a", closes=PAST), Phase(name="b", opens=NOON)), 201, "", id="second"
        ),
    ],
)
def test_a_split_takes_submissions_while_a_phase_is_open(
    phases: tuple[Phase, ...],
    status: int,
    message: str,
    folder: Path,
    open_server: OpenServer,
) -> None:
    server = open_server(adjusted(settings_of(folder), OPEN, phases=phases))
    reply = server.upload(OWNER)
    assert reply.status_code == status
    assert message in reply.text


@pytest.mark.parametrize(
    ("required", "said", "missing"),
    [
        pytest.param((), {}, None, id="nothing"),
        pytest.param(("description",), {}, "description", id="a text that is not there"),
        pytest.param(("description",), {"description": ""}, "description", id="an empty text"),
        pytest.param(("description",), {"description": "walks"}, None, id="a text"),
        pytest.param(("paper", "code"), {"code": "https://x.org"}, "paper", id="one of two links"),
        pytest.param(("ensemble",), {}, "ensemble", id="a flag that is not there"),
        pytest.param(("ensemble",), {"ensemble": "false"}, None, id="a flag that says no"),
        pytest.param(("paper", "ensemble"), {}, "paper, ensemble", id="two"),
    ],
)
def test_what_the_organiser_asks_for_has_to_be_said_of_a_method(
    required: tuple[Metadata, ...],
    said: dict[str, str],
    missing: str | None,
    folder: Path,
    open_server: OpenServer,
) -> None:
    asking = settings_of(folder).model_copy(update={"required_metadata": required})
    server = open_server(asking)
    reply = server.upload(OWNER, GOOD, **said)
    assert reply.status_code == (201 if missing is None else 400)
    if missing:
        assert reply.json()["detail"].endswith(f"the method is missing: {missing}")
        assert server.ask(OWNER, "GET", "/submissions").json() == []


def test_settings_cannot_be_changed(tmp_path: Path) -> None:
    settings = loaded(tmp_path)
    with pytest.raises(ValueError, match="frozen"):
        settings.title = "x"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("address", "proxies", "is_warned"),
    [
        pytest.param("https://eval.example.org", "[]", True, id="nobody is trusted"),
        pytest.param("https://eval.example.org", '["127.0.0.1"]', False, id="a proxy is trusted"),
        pytest.param("http://localhost:8000", "[]", False, id="no TLS"),
        pytest.param("", "[]", False, id="no address"),
    ],
)
def test_tls_needs_a_proxy_that_is_trusted(
    address: str,
    proxies: str,
    is_warned: bool,  # noqa: FBT001  # a column of the table
    lab: str,
    laptop: Laptop,
) -> None:
    variables = {
        "REVERIE_EVAL_PUBLIC_ADDRESS": address,
        "REVERIE_EVAL_TRUSTED_PROXIES": proxies,
    }
    checked = laptop.run("server", "doctor", "--quick", lab, variables=variables)
    assert ("trusted_proxies is empty" in checked.out) is is_warned


@pytest.mark.parametrize(
    "address",
    [
        pytest.param("eval.example.org", id="no scheme"),
        pytest.param("ftp://eval.example.org", id="another scheme"),
        pytest.param("https://me:secret@eval.example.org", id="a password"),
        pytest.param("https://eval.example.org/my board", id="a space in the path"),
        pytest.param("https://eval.example.org//reverie", id="an empty part of the path"),
        pytest.param("https://eval.example.org/?q", id="a query"),
    ],
)
def test_a_public_address_is_a_scheme_a_host_and_a_plain_path(
    address: str, lab: str, laptop: Laptop
) -> None:
    variables = {"REVERIE_EVAL_PUBLIC_ADDRESS": address}
    told = laptop.run("server", "doctor", "--quick", lab, status=1, variables=variables).out
    assert "public_address" in told


@pytest.mark.parametrize(
    ("dataset", "is_warned"),
    [pytest.param("REVERIE v1", True, id="real"), pytest.param("demo", False, id="the demo world")],
)
def test_a_small_private_split_is_warned_of(
    dataset: str,
    is_warned: bool,  # noqa: FBT001  # a column of the table
    folder: Path,
    laptop: Laptop,
) -> None:
    rename_dataset(folder, "test", dataset)
    checked = laptop.run("server", "doctor", "--quick", folder)
    assert ("test is private and has only 91 episodes" in checked.out) is is_warned
    assert "val_unseen is private" not in checked.out


@pytest.mark.parametrize(
    ("real", "said"),
    [
        pytest.param((), None, id="the demo world alone"),
        pytest.param(("test", "val_seen", "val_unseen"), None, id="real data alone"),
        pytest.param(("test",), "val_seen, val_unseen are of the synthetic demo", id="two left"),
        pytest.param(("test", "val_seen"), "val_unseen is of the synthetic demo", id="one left"),
    ],
)
def test_a_split_of_the_demo_world_beside_real_ones_is_named(
    real: Sequence[str], said: str | None, folder: Path, run: Run
) -> None:
    for split in real:
        rename_dataset(folder, split, "REVERIE v1")
    checked = run("server", "doctor", "--quick", str(folder))
    assert (checked.status, "demo world" in checked.out) == (0, said is not None)
    assert (said or "") in checked.out
