"""The commands of ``workbench``, one module a command, of its name: options are parsed, results written and printed.

Such a module has ``run(options, console) -> int``, which returns the exit status; the command line imports it once the
options are parsed. A command is added by its module here and by its parser in :mod:`workbench.commands.options`.
"""
