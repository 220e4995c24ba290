"""The commands of ``workbench``, one module each.

A module has ``run_<command>(options, console) -> int``, which runs the command with parsed options, writes and prints
results, and returns the exit status. The command line imports it after parsing. A command is added by its module here
and by its parser in :mod:`workbench.commands.options`.
"""
