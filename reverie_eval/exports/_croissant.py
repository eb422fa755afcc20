"""The published files of a dataset, described in Croissant for search engines and loaders.

References
----------
Croissant Format Specification 1.1, http://mlcommons.org/croissant/1.1.
"""

import hashlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from msgspec.structs import FieldInfo, fields
from pydantic import TypeAdapter

from reverie_eval.dataset import DatasetFiles
from reverie_eval.dataset._reader import Reader, has_lines
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.exports._croissant_task import task_problem
from reverie_eval.tasks import Task

_CONFORMS_TO = "http://mlcommons.org/croissant/1.1"
_JSON = "application/json"
_JSON_LINES = "application/jsonlines"
_TYPES: Mapping[type, str] = {int: "sc:Integer", float: "sc:Float", str: "sc:Text"}
_RECORDS = TypeAdapter(list[dict[str, Any]])
_YEAR = re.compile(r"[0-9]{4}$")
# fmt: off
_OWN_TERMS = (
    "annotation", "arrayShape", "citeAs", "column", "containedIn", "equivalentProperty",
    "excludes", "extract", "field", "fileObject", "fileProperty", "fileSet", "format", "includes",
    "isArray", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "readLines",
    "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "sdVersion",
    "separator", "source", "subField", "transform", "unArchive", "value",
)
# fmt: on
"""The terms that its recommended context abbreviates: appendix 1, and those of mlcroissant."""


def croissant(files: DatasetFiles) -> Mapping[str, Any]:
    """Return the description of a dataset's files and of their task, as JSON-LD.

    Annotation files have their SHA-256, and a record set with the fields that scoring reads, apart
    from nested objects. Paths are relative to the root of a clone of the published repository,
    wherever the files are now.

    Raises
    ------
    DatasetError
        If an annotation file is not a list of records, or JSON Lines.
    OSError
        If a file cannot be read.
    """
    task = files.task
    year = _YEAR.search(task.citation)
    return {
        "@context": _context(),
        "@type": "sc:Dataset",
        "conformsTo": _CONFORMS_TO,
        "name": task.title,
        "description": f"Annotations of the {task.title} benchmark: {', '.join(files.annotations)}"
        f"{', boxes of objects' if files.boxes else ''} and navigation graphs.",
        "url": f"https://{task.source}",
        "license": task.licence,
        "citeAs": task.citation,
        "creator": {"@type": "sc:Person", "name": task.citation.partition(",")[0]},
        **({"datePublished": year[0]} if year else {}),
        "inLanguage": "en",
        "distribution": list(_distribution(files)),
        "recordSet": [_record_set(task, split, path) for split, path in files.annotations.items()],
        "subjectOf": task_problem(task, files.annotations),
    }


def annotation_id(split: str) -> str:
    """Return the id of a split's annotation file in the description."""
    return f"annotations-{split}"


def _context() -> Mapping[str, Any]:
    return {
        "@language": "en",
        "@vocab": "https://schema.org/",
        "sc": "https://schema.org/",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "dct": "http://purl.org/dc/terms/",
        "conformsTo": "dct:conformsTo",
        "data": {"@id": "cr:data", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        "examples": {"@id": "cr:examples", "@type": "@json"},
        **{term: f"cr:{term}" for term in _OWN_TERMS},
    }


def _distribution(files: DatasetFiles) -> Iterator[Mapping[str, Any]]:
    folder = files.task.folder
    for split, path in files.annotations.items():
        yield _file(annotation_id(split), folder, path, f"The episodes of {split}.")
    if files.boxes:
        what = "The boxes of the objects that are visible from each viewpoint."
        if files.boxes.is_file():
            yield _file("boxes", folder, files.boxes, what)
        else:
            yield _file_set("boxes", f"{folder}/{files.boxes.name}/*.json", what)
    graphs = f"{files.connectivity.name}/*_connectivity.json"
    yield _file_set("navigation-graphs", graphs, "The navigation graph of each building.")


def _file(name: str, folder: str, path: Path, description: str) -> Mapping[str, Any]:
    content = path.read_bytes()
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": path.name,
        "description": description,
        "contentUrl": f"{folder}/{path.name}",
        "encodingFormat": _JSON_LINES if has_lines(path.name) else _JSON,
        "contentSize": f"{len(content)} B",
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _file_set(name: str, pattern: str, description: str) -> Mapping[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": description,
        "encodingFormat": _JSON,
        "includes": pattern,
    }


def _common_fields(path: Path) -> set[str]:
    """Return the fields that all records of a file have; a public test file has no answers."""
    records = Reader().read(_RECORDS, path, "annotations")
    if records is None:
        remedy = "is not a JSON list of records; `reverie-eval lint` says what is wrong with it"
        raise DatasetError([Problem("unreadable-file", str(path), remedy)])
    return set.intersection(*map(set, records)) if records else set()


def _record_set(task: Task, split: str, path: Path) -> Mapping[str, Any]:
    present = _common_fields(path)
    given = [each for each in fields(task.annotation) if each.encode_name in present]
    return {
        "@type": "cr:RecordSet",
        "@id": split,
        "name": split,
        "description": f"The records of {task.file_name.format(split=split)}.",
        "field": [
            _field(split, each, has_lines=has_lines(path.name))
            for each in given
            if _kind(each.type)[0] in _TYPES  # records have no rows of objects to load them into
        ],
    }


def _field(split: str, field: FieldInfo, *, has_lines: bool) -> Mapping[str, Any]:
    name = field.encode_name
    kind, depth = _kind(field.type)
    return {
        "@type": "cr:Field",
        "@id": f"{split}/{name}",
        "name": name,
        "dataType": _TYPES[kind],
        **({"isArray": True, "arrayShape": ",".join(["-1"] * depth)} if depth else {}),
        "source": {
            "fileObject": {"@id": annotation_id(split)},
            "extract": {"column": name} if has_lines else {"jsonPath": f"$[*].{name}"},
        },
    }


def _kind(annotated: Any, depth: int = 0) -> tuple[type, int]:
    """Return the type of a field's values, text if there are several, and of how many lists."""
    parts = [part for part in get_args(annotated) if part is not type(None)]
    origin = get_origin(annotated)
    if origin in (Union, UnionType):
        return (str, depth) if len(parts) > 1 else _kind(parts[0], depth)
    if origin is Literal:
        return type(parts[0]), depth
    if origin is list:
        return _kind(parts[0], depth + 1)
    return _kind(parts[0], depth) if parts else (annotated, depth)
