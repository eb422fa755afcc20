"""The address of a server: its normal form, and whether it is safe to send a token there."""

from ipaddress import ip_address

import httpx

from reverie_eval.client._errors import ServiceError

API = "/api/v1"
"""Where a server has its API."""


def server_url(text: str) -> str:
    """Return a server's URL in normal form, without the API's path; others are a ServiceError.

    >>> server_url(" https://Reverie.example.org/api/v1/ ")
    'https://reverie.example.org'
    """
    try:
        url = httpx.URL(text.strip())
    except httpx.InvalidURL:
        url = httpx.URL()
    if url.scheme not in ("http", "https") or not url.host or url.userinfo:
        raise ServiceError(f"{text!r} is not a server URL; write it as https://HOST")
    return str(url.copy_with(query=None, fragment=None)).rstrip("/").removesuffix(API)


def check_private(server: str) -> None:
    """Refuse a server that is reached without encryption, unless it is on this machine."""
    url = httpx.URL(server)
    if url.scheme == "http" and not is_this_machine(url.host):
        raise ServiceError(
            f"{server} is not encrypted: others on the network could read your token and change "
            "the data; use https://, or allow it with --plain-http on a network that you trust"
        )


def is_this_machine(host: str) -> bool:
    """Whether a host name or address means this machine.

    >>> [is_this_machine(host) for host in ("localhost", "127.0.0.2", "::1", "192.168.1.7")]
    [True, True, True, False]
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
    return address.is_loopback or address.is_unspecified
