"""A home of two storeys with an episode of every outcome: what episodes, maps and reports show.

The cellar is the ground floor's size and 3 m below; stairs lead up between.
"""

import json
from pathlib import Path

from reverie_eval import GroundTruth, Scores, evaluate
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.ground_truth import DEMO_BUNDLES
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import SPLIT, write_world

LAMP, SOFA = 3, 4
HOME = World(
    {
        "home": Scan(
            {
                "cellar": Viewpoint((0.0, 0.0, 0.0)),
                "rack": Viewpoint((4.0, 0.0, 0.0)),
                "shelf": Viewpoint((8.0, 0.0, 0.1)),
                "stairs": Viewpoint((10.0, 0.0, 1.6)),
                "hall": Viewpoint((10.0, 4.0, 3.0), views={SOFA: [12]}),
                "room": Viewpoint((10.0, 10.0, 3.0), views={LAMP: [12], SOFA: [12]}),
                "porch": Viewpoint((10.0, 14.0, 3.2), views={LAMP: [13]}),
            },
            frozenset(
                {
                    ("cellar", "rack"),
                    ("rack", "shelf"),
                    ("shelf", "stairs"),
                    ("stairs", "hall"),
                    ("hall", "room"),
                    ("room", "porch"),
                }
            ),
        )
    },
    [
        Item("1_3", "home", ["hall", "room"], LAMP, instructions=3),
        Item("2_4", "home", ["porch", "room", "hall"], SOFA, instructions=2),
    ],
)
WALKS = {
    "1_3_0": (["hall", "room"], LAMP),  # right
    "1_3_1": (["hall", "room", "porch"], SOFA),  # wrong object, 4 m beyond the path's end
    "1_3_2": (["hall"], LAMP),  # correct object at the wrong stop, 6 m from the path's end
    "2_4_0": (["porch", "room", "porch"], LAMP),  # overshot: the sofa is seen from the room
    "2_4_1": (["porch"], -1),  # never reached
}
OTHER_WALKS = {
    **WALKS,
    "1_3_0": (["hall", "stairs", "shelf"], -1),  # never reached, and down the stairs
    "2_4_0": (["porch"], LAMP),  # never reached
    "2_4_1": (["porch", "room", "hall"], SOFA),  # right
}


def home_scores(
    folder: Path,
    walks: dict[str, tuple[list[str], int]] = WALKS,
    protocol: str = "official-v1",
    **replaced: str,
) -> Scores:
    """Score walks through the home; words in its files may be replaced by others."""
    write_world(HOME, folder)
    for file in (folder / "tasks" / "REVERIE" / "data").iterdir():
        text = file.read_text()
        for word, other in replaced.items():
            text = text.replace(word.replace("_", " "), other)
        file.write_text(text)
    files = DatasetFiles.find(folder, split=SPLIT)
    bundle = folder / "home.npz"
    compile_split(files, SPLIT).save(bundle)
    return evaluate(records(walks), split=SPLIT, ground_truth=bundle, protocol=protocol)


def records(walks: dict[str, tuple[list[str], int]]) -> list[dict[str, object]]:
    """Return walks as a submission."""
    return [
        {"instr_id": id_, "trajectory": [[place, 0, 0] for place in walk], "predObjId": answer}
        for id_, (walk, answer) in walks.items()
    ]


def perfect() -> list[dict[str, object]]:
    """Walk every annotated path of the demo world and name every target."""
    truth = GroundTruth.load(DEMO_BUNDLES / f"{SPLIT}.npz")
    solution, ids = truth.require_solution(), truth.graph.viewpoint_ids
    return [
        {
            "instr_id": instr_id,
            "trajectory": [[ids[node], 0, 0] for node in path_of(truth, row)],
            "predObjId": int(solution.target_object[row]),
        }
        for row, instr_id in enumerate(truth.episodes.instr_ids)
    ]


def path_of(truth: GroundTruth, row: int) -> list[int]:
    """Return an episode's annotated path."""
    item = truth.episodes.item[row]
    offsets = truth.require_solution().path_offsets
    path: list[int] = truth.require_solution().path[offsets[item] : offsets[item + 1]].tolist()
    return path


def home_log(folder: Path, walks: dict[str, tuple[list[str], int]] = WALKS, said: str = "") -> Path:
    """Write what a run would log of walks: 10 tokens and a tenth of a dollar for each step."""
    episodes: list[object] = []
    steps: list[object] = []
    for id_, (walk, answer) in walks.items():
        attempt = {"episode": id_, "attempt": 1, "seconds": 0.5 * len(walk)}
        cost = {"input_tokens": 10 * len(walk), "money": 0.1 * len(walk)}
        episodes.append({**attempt, **cost, "state": "ended", "steps": len(walk)})
        actions: list[tuple[str, object]] = [("Go", {"viewpoint_id": each}) for each in walk[1:]]
        actions.append(("Answer", {"object_id": answer}))
        steps += [
            {
                "episode": id_,
                "attempt": 1,
                "step": number,
                "seconds": 0.5,
                "viewpoint_id": viewpoint,
                "heading": 0.0,
                "elevation": 0.0,
                "action": action,
                "arguments": arguments,
                "input_tokens": 10,
                "money": 0.1,
                "notes": {"said": said} if said else {},
            }
            for number, (viewpoint, (action, arguments)) in enumerate(
                zip(walk, actions, strict=True), 1
            )
        ]
    for name, rows in (("episodes", episodes), ("steps", steps)):
        (folder / f"{name}.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return folder
