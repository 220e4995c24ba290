"""What each command of ``workbench`` does with its options: one module a command, of the command's name.

Such a module has ``run(options, console) -> int``, which returns the exit status; the command line imports it once the
options are parsed. A command is added by its module here and by its parser in :mod:`workbench.commands.options`.
"""
