"""Submit files for people who sent them to the organiser, by e-mail for example."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from reverie_eval.schemas.service import Accepted, Method, SubmissionChange
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.service.people import person_named
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person


@dataclass(frozen=True, slots=True)
class Delivery:
    """Files that a person sent to the organiser."""

    state: ServerState
    person: Person
    split: str
    received: datetime
    organiser: str

    def submit(self, path: Path, method: Method, *, publish: bool) -> Accepted:
        """Score a file as if it had been uploaded when it was received.

        A file that was submitted before gets its earlier result.

        Raises
        ------
        SubmissionError, RequestError
            As an upload.
        OSError
            If the file cannot be read.
        """
        accepted = self.state.intake.submit(
            self.person,
            self.split,
            path.read_bytes(),
            method,
            key=None,
            arrived=self.received,
            organiser=self.organiser,
        )
        if not publish or accepted.submission.status == "published":
            return accepted
        published = self.state.submissions.change(
            self.person, accepted.submission.id, SubmissionChange(published=True), self.organiser
        )
        return accepted.model_copy(update={"submission": published})


def delivery(
    state: ServerState, *, team: str, person: str, split: str, received: datetime, organiser: str
) -> Delivery:
    """Return files of a person, to be submitted to a split.

    Raises
    ------
    NotFoundError
        If the team has no such person, or the server no such split.
    MalformedError
        If the time is in the future.
    """
    state.board(split)
    with state.database.reading() as session:
        sender = person_named(session, person, team)
    if received > state.clock():
        raise MalformedError("the time at which files were received is in the future")
    return Delivery(state, sender, split, received, organiser)
