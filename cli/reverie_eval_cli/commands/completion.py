"""``reverie-eval completion SHELL``: print what makes the shell complete this command."""

import argparse

SUMMARY = 'print shell completion; for bash: eval "$(reverie-eval completion bash)"'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("shell", choices=("bash", "zsh", "fish", "powershell"))


def run(arguments: argparse.Namespace) -> int:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["reverie-eval"], shell=arguments.shell))
    return 0
