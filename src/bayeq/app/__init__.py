"""The local page of ``bayeq app``: a file in, its equation out, by the commands of bayeq in processes of their own.

server    one page for one browser on this computer
guard     who may talk to it
session   what was opened, chosen and found
page      the steps of the page
parts     its smaller pieces
look      its style sheet, added to that of the report
workspace a private folder for files and results
roles     channels, their roles, and the chains that these make
commands  the commands that are run, from what was chosen
child     a command in a process of its own, which can be stopped
"""
