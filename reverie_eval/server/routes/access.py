"""What the server is, who one is, how to get in, and the key that receipts are checked with."""

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas.service import Invitation, Me, ServerReport, Welcome
from reverie_eval.server.http.callers import Caller, Server
from reverie_eval.server.http.examples import KEY_PEM
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.service.tokens import accept_invitation
from reverie_eval.version import __version__

router = APIRouter(tags=["access"])


@router.get("/server")
def show_server(server: Server) -> ServerReport:
    """Say what the server is, and what its organiser has to say to everybody."""
    with server.database.reading() as session:
        notice = server.notices.current(session)
    return ServerReport(
        title=server.settings.title,
        version=__version__,
        banner=notice.banner,
        paused=notice.paused,
        key_id=server.signer.key_id,
        required_metadata=list(server.settings.required_metadata),
    )


@router.get("/me", responses=problems("not-signed-in"))
def show_me(caller: Caller) -> Me:
    """Say who you are."""
    person = caller.person()
    return Me(person=person.name, team=person.team.name, role=person.role)


@router.post("/tokens", status_code=201, responses=problems("not-signed-in"))
def exchange_invitation(invitation: Invitation, server: Server) -> Welcome:
    """Turn an invitation into a token, once."""
    with server.transactions.begin("") as transaction:
        return accept_invitation(transaction, invitation.invitation)


@router.get(
    "/key",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {"example": KEY_PEM}}}},
)
def show_key(server: Server) -> str:
    """Return the public key that receipts are checked with, in PEM form."""
    return server.signer.public_pem
