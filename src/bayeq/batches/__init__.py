"""`batch`: the equations of many files, kept in a file as they are found.

files   which files, and whether one has changed
store   results in an SQLite file
run     what is missing is done, by several processes
result  the table over files
summary what has drifted, in a few lines
"""
