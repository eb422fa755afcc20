"""What evidence about submissions adds to the server."""

from reverie_eval.server.integrity import desk, routes
from reverie_eval.server.rooms import Room, Tab

ROOM = Room(
    routes=[routes.organising],
    pages=[desk.router],
    desk=[
        Tab("Results", 2, "Evidence", "/desk/evidence"),
    ],
)
