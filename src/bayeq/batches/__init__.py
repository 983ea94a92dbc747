"""`batch`: the equations of many files, kept in a file as they are found.

options what a batch is asked, and which files: what tells them from others
run     what is missing is done by several processes, and kept
result  the table over files, and what has drifted
"""
