"""The tasks: REVERIE and its sister benchmarks, each a record of what differs between them.

A task says how its annotations are read, which submissions it expects, by which rules they are
scored, and by which metrics they are ranked. Everything else in the package is the same for all.
"""

from reverie_eval.tasks._annotation import (
    AnnotatedPath,
    Annotation,
    EpisodeAnnotation,
    Outline,
    PathAnnotation,
    ViewpointId,
    turns_of,
)
from reverie_eval.tasks._codebases import (
    Codebase,
    CodebaseEvaluator,
    CodebaseFile,
    codebases,
    find_codebase,
)
from reverie_eval.tasks._fields import (
    ANSWER,
    BOX,
    ID_PREFIX,
    IMAGE_SIZE,
    INSTR_ID,
    ITEM_MARK,
    OBJECT,
    POINT,
    TRAJECTORY,
    VIEW,
    Field,
)
from reverie_eval.tasks._published import PublishedResult, published_on, published_results
from reverie_eval.tasks._registry import (
    BUILT_IN,
    DEFAULT_TASK,
    ENTRY_POINTS,
    PROTOCOLS,
    find_task,
    name_on_server,
    task_names,
)
from reverie_eval.tasks._task import (
    DEFAULT_PROTOCOL,
    TO_REGION,
    GoalRule,
    HopReading,
    KnownSplit,
    Paper,
    Protocol,
    Task,
)

__all__ = [
    "ANSWER",
    "BOX",
    "BUILT_IN",
    "DEFAULT_PROTOCOL",
    "DEFAULT_TASK",
    "ENTRY_POINTS",
    "ID_PREFIX",
    "IMAGE_SIZE",
    "INSTR_ID",
    "ITEM_MARK",
    "OBJECT",
    "POINT",
    "PROTOCOLS",
    "TO_REGION",
    "TRAJECTORY",
    "VIEW",
    "AnnotatedPath",
    "Annotation",
    "Codebase",
    "CodebaseEvaluator",
    "CodebaseFile",
    "EpisodeAnnotation",
    "Field",
    "GoalRule",
    "HopReading",
    "KnownSplit",
    "Outline",
    "Paper",
    "PathAnnotation",
    "Protocol",
    "PublishedResult",
    "Task",
    "ViewpointId",
    "codebases",
    "find_codebase",
    "find_task",
    "name_on_server",
    "published_on",
    "published_results",
    "task_names",
    "turns_of",
]
