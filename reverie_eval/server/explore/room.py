"""What exploring episodes adds to the server."""

from reverie_eval.server.explore import compare_page, pages, play_page
from reverie_eval.server.explore.first_page import Showcase
from reverie_eval.server.rooms import Room

ROOM = Room(pages=[pages.router, compare_page.router, play_page.router], showcase=Showcase)
