"""The local page of ``bayeq app``: a file in, its equation out, by the commands of bayeq in processes of their own.

server    one page for one browser on this computer
guard     who may talk to it
session   what was opened, chosen and found, and a private folder for files and results
page      the steps of the page, their pieces, and their style sheet
choices   channels, their roles, and the command that these make
child     a command in a process of its own, which can be stopped
"""
