"""``/desk``: the pages of the organiser."""

from fastapi import APIRouter

from reverie_eval.server.pages.desk import (
    announcements,
    overview,
    people,
    reported,
    splits,
    submissions,
)

router = APIRouter()
for part in (overview, people, splits, submissions, reported, announcements):
    router.include_router(part.router)
