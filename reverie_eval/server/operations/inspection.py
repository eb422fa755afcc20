"""Look at the episodes of one submission, on the server's own machine.

Values of single episodes of a private split are never sent over the network. Here they are shown to
a user who can read the ground truth anyway, and the audit log records it.
"""

from reverie_eval.schemas.service import ScoredSubmission
from reverie_eval.scoring import Scores
from reverie_eval.server.boards.reviews import any_submission
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.intake.submissions import record_inspection
from reverie_eval.server.opening import opened_server
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.uploads import stored_upload


def inspect(
    settings: Settings, submission_id: str, *, actor: str
) -> tuple[ScoredSubmission, Scores]:
    """Return a submission, and the value of every episode, scored again from its upload.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    NotFoundError
        If there is no such submission, or its split is no longer served.
    UploadsError
        If its upload is missing or damaged.
    ConflictError
        If the means are not the stored scores, or the file was deleted because of its age.
    """
    with opened_server(settings) as state:
        with state.database.reading() as session:
            row = any_submission(session, submission_id)
            if row.upload_deleted_at is not None:
                raise ConflictError(
                    f"the file of {submission_id} was deleted on {row.upload_deleted_at:%Y-%m-%d}, "
                    "because it was old and not published"
                )
            known = row.as_scored()
        board = state.board(known.split)
        if not board.measures_as(known.report):
            raise ConflictError(
                f"{submission_id} was scored before the ground truth or the rules changed; "
                f"run `reverie-eval server rescore {settings.folder} {board.split}` first"
            )
        reading = board.read(stored_upload(state.uploads, known.sha256))
        scores = board.score(reading)
        if board.report(scores, reading).scores != known.report.scores:
            raise ConflictError(
                f"{submission_id}: the upload does not give the stored scores; run `reverie-eval "
                f"server doctor {settings.folder}`"
            )
        with state.transactions.begin(actor) as transaction:
            record_inspection(transaction, submission_id)
    return known, scores
