"""What accounts add to the server."""

from reverie_eval.server.accounts import access, desk
from reverie_eval.server.rooms import Room, Tab

ROOM = Room(
    routes=[access.routes, desk.routes],
    pages=[access.pages, desk.pages],
    desk=[
        Tab("Today", 3, "Requests", "/desk/requests"),
        Tab("Participants", 1, "People", "/desk/people"),
    ],
)
