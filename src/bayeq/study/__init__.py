"""Monte Carlo campaigns: the paper's section 4.1 as a study that can be stopped, continued and shown.

config     what a study is: its numbers and its names
algorithms the methods compared, a table
realise    one realisation, reproducible alone from (seed, system, index)
metrics    what an algorithm gives, and its errors as the paper defines them
store      results in an SQLite file
runner     all realisations, in parallel
table      averages beside the paper's
show       the tables with their notes, as text, Markdown, CSV or JSON
figures    the paper's Figs. 4 and 5
"""
