"""The local page of ``bayeq app``: a file in, its equation out, by the commands of bayeq in processes of their own.

server    one page for one browser on this computer, and who may talk to it
session   what was opened, chosen and found, a private folder for it, and commands in processes of their own
page      the steps of the page and their pieces; page.css is their style sheet
choices   channels, their roles, and the command that these make
"""
