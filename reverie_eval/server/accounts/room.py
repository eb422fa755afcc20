"""What accounts add to the server."""

from reverie_eval.server.accounts import desk, pages, routes
from reverie_eval.server.rooms import Room, Tab

ROOM = Room(
    routes=[routes.router, desk.routes],
    pages=[pages.router, desk.pages],
    desk=[
        Tab("Today", 3, "Requests", "/desk/requests"),
        Tab("Participants", 1, "People", "/desk/people"),
    ],
)
