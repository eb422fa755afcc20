"""``/desk``: the pages of the organiser."""

from fastapi import APIRouter

from reverie_eval.server.pages.desk import (
    corrections,
    emailed_files,
    evidence,
    news,
    notice,
    overview,
    people,
    phases,
    quotas,
    reported,
    requests,
    reviews,
    snapshots,
)

router = APIRouter()
for part in (
    overview,
    people,
    requests,
    quotas,
    phases,
    snapshots,
    reviews,
    reported,
    emailed_files,
    corrections,
    evidence,
    news,
    notice,
):
    router.include_router(part.router)
