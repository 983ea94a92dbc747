"""`batch`: the equations of many files, kept in a file as they are found.

files   which files, and whether one has changed
options what a batch is asked, and what tells it from others
run     what is missing is done by several processes, and kept
result  the table over files, and what has drifted
"""
