"""The local page of ``bayeq app``: a file in, its equation out, by the commands of bayeq in processes of their own.

server    one page for one browser on this computer, and access control
session   state of the page, a private folder for its files, and commands in separate processes
page      the steps of the page and their pieces; page.css is their style sheet
choices   roles of channels and other choices, and the command made from them
"""
