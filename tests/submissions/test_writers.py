"""Forms in tests and in the list of codebases are those that public code was seen to write.

The writers themselves run by ``scripts/evidence writers``, which needs clones. A made-up codebase
stands for them here.
"""

import json
import subprocess
from pathlib import Path

import pytest

from reverie_eval.submissions import read_predictions
from reverie_eval.tasks import Codebase, CodebaseFile, codebases, find_task
from tests.support import writers
from tests.support.forms import FORMS, OFFICIAL
from tests.support.writers import Valid, agents_of, describe, lines_about, what_is_read

EXECUTED = [
    pytest.param(codebase, file, id=f"{codebase.name}, {file.form}")
    for codebase in codebases()
    for file in codebase.file
    if file.executed
]
WITHOUT = {record["instr_id"] for record in OFFICIAL if record["predObjId"] == -1}
REFUSED = ("one record in each file", "list; trajectory an object")
"""MapGPT's records, and DUET's of SOON, whose ids do not identify the item."""
METRICS = ", spl, success"
"""What NaviLLM adds with --save_detail_results."""


@pytest.mark.parametrize("name", [name for name in FORMS if name[1] == " "])
def test_a_form_with_a_letter_was_written_by_public_code(name: str) -> None:
    executed = {file.form for codebase in codebases() for file in codebase.file if file.executed}
    assert describe(FORMS[name].write(), WITHOUT).removesuffix(METRICS) in executed


@pytest.mark.parametrize(("codebase", "file"), EXECUTED)
def test_a_record_that_public_code_wrote_is_read(codebase: Codebase, file: CodebaseFile) -> None:
    if file.example and not file.form.startswith(REFUSED):
        document = json.loads(file.example)
        records = [document] if "trajectory" in document else list(document.values())
        of = {"inst_idx": "ndh", "trajectory a list": "soon"}
        task = next((task for sign, task in of.items() if sign in file.form), "reverie")
        assert not read_predictions(records, find_task(task)).problems


# A codebase that walks twice to each viewpoint but the last, answers with numbers, and merges.

MAIN = """
def valid(args, val_envs, rank=-1):
    agent_class = HouseAgent
    agent = agent_class(args)
    for env_name, env in val_envs.items():
        agent.test(use_dropout=False)
        preds = merge_dist_results(all_gather(agent.get_results()))
        if args.submit:
            with open(os.path.join(args.pred_dir, "out_%s.json" % env_name), "w") as file:
                json.dump(preds, file)
"""
AGENT = """
import torch

class Base:
    def test(self, **options):
        for traj in self.rollout():
            self.results[traj["instr_id"]] = traj

    def get_results(self):
        return [{"instr_id": k, "trajectory": v["path"], "predObjId": v["predObjId"]}
                for k, v in self.results.items()]

class HouseAgent(Base):
    @torch.no_grad()
    def make_equiv_action(self, a_t, obs, traj):
        sim = self.env.env.sims[0]
        sim.makeAction([obs[0]["candidate"][0]["idx"]], [0], [0])
        traj[0]["path"].append([sim.getState()[0].location.viewpointId])

    def rollout(self):
        obs = self.env.reset()
        traj = [{"instr_id": ob["instr_id"], "path": [[ob["viewpoint"]]], "predObjId": None}
                for ob in obs]
        cpu_a_t = self.model(obs)
        for i, a in enumerate(cpu_a_t):
            if len(obs[i]["candidate_obj"][2]):
                traj[i]["predObjId"] = int(obs[i]["candidate_obj"][2][0])
        return traj
"""
MERGE = """
def merge_dist_results(parts):
    return [each for part in parts for each in part]
"""


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a clone of a codebase with a writer."""
    files = {"main.py": MAIN, "agent.py": AGENT, "distributed.py": MERGE}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    git = ["git", "-c", "user.name=me", "-c", "user.email=me@localhost", "-C", str(tmp_path)]
    for command in (["init", "-q"], ["add", "."], ["commit", "-qm", "All"]):
        subprocess.run([*git, *command], check=True)
    writer = Valid("main.py", ["agent.py"], "agent.py")
    monkeypatch.setattr(writers, "WRITERS", {tmp_path.name: [writer]})
    return tmp_path


def test_a_writer_runs_and_its_file_is_read(clone: Path) -> None:
    _, form, read, listed, record = lines_about(clone)
    assert form.strip() == "list; [viewpoint]; predObjId a number, null without an object"
    assert read.strip() == "read as meant"
    assert listed.strip() == "not so in codebases.toml"
    assert json.loads(record) == {
        "instr_id": "4_402_2",
        "trajectory": [["hall"], ["stairs"], ["attic"], ["stairs"], ["hall"]],
        "predObjId": 17,
    }


@pytest.mark.parametrize(
    ("old", "new", "read"),
    [
        pytest.param(
            'int(obs[i]["candidate_obj"][2][0])',
            "7",
            "read 4_402_0 predicts 7 instead of 402; 4_402_1 predicts 7 instead of 0; "
            "4_402_2 predicts 7 instead of 17",
            id="answers",
        ),
        pytest.param(
            '"predObjId": None',
            '"predObjId": 0',
            "read 5_17_0 predicts 0 instead of -1; 5_17_1 predicts 0 instead of -1",
            id="no object",
        ),
        pytest.param(
            '"trajectory": v["path"]',
            '"trajectory": v["path"][:2]',
            "read 4_402_0 walks ['hall', 'stairs'] instead of ['hall', 'stairs', 'attic']; ",
            id="walks",
        ),
        pytest.param(
            '"predObjId": v["predObjId"]',
            '"predObjId": [v["predObjId"]]',
            "read rejected: [0].predObjId: 5 records have a value in a list of one, such as [402]",
            id="form",
        ),
    ],
)
def test_a_difference_is_told(old: str, new: str, read: str, clone: Path) -> None:
    source = (clone / "agent.py").read_text()
    assert source.count(old) == 1
    (clone / "agent.py").write_text(source.replace(old, new))
    told = [line.strip() for line in lines_about(clone)]
    assert told[2].startswith(read)


def test_each_task_has_its_ids() -> None:
    assert [agent.instr_id for agent in agents_of("ndh")] == ["41", "42", "43", "44", "45"]
    assert [agent.instr_id for agent in agents_of("reverie")][:2] == ["4_402_0", "4_402_1"]
    records = [
        {"inst_idx": int(agent.instr_id), "trajectory": [[each, 0, 0] for each in agent.viewpoints]}
        for agent in agents_of("ndh")
    ]
    assert what_is_read(json.dumps(records).encode(), "ndh") == "as meant"
