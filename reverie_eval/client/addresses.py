"""Where servers are: their URLs, and whether the way there is private."""

from ipaddress import ip_address

import httpx

from reverie_eval.client.errors import ServiceError

API = "/api/v1"


def server_url(text: str) -> str:
    """Return a server's URL in its one form, without the API's path.

    Raises
    ------
    ServiceError
        If it is none.

    Examples
    --------
    >>> server_url(" https://Reverie.example.org/api/v1/ ")
    'https://reverie.example.org'
    """
    try:
        url = httpx.URL(text.strip())
    except httpx.InvalidURL:
        url = httpx.URL()
    if url.scheme not in ("http", "https") or not url.host or url.userinfo:
        raise ServiceError(f"{text!r} is no URL of a server; write it as https://HOST")
    return str(url.copy_with(query=None, fragment=None)).rstrip("/").removesuffix(API)


def check_private(server: str) -> None:
    """Refuse a server that is reached without encryption, unless it is on this machine.

    Raises
    ------
    ServiceError
        Naming the remedies.
    """
    url = httpx.URL(server)
    if url.scheme == "http" and not is_here(url.host):
        raise ServiceError(
            f"{server} is not encrypted: others on the way could read your token and change what "
            "is said; use https://, or, in a network that you trust, allow it with --plain-http"
        )


def is_here(host: str) -> bool:
    """Whether a host is this machine.

    >>> is_here("localhost"), is_here("127.0.0.2"), is_here("::1"), is_here("192.168.1.7")
    (True, True, True, False)
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
    return address.is_loopback or address.is_unspecified
