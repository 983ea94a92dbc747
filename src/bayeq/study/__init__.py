"""Monte Carlo campaigns: the paper's section 4.1 as a study that can be stopped, continued and shown.

config     what a study is: its numbers and its names
metrics    the errors of one estimate, as the paper defines them
algorithms the methods compared, a table
realise    one realisation, reproducible alone from (seed, system, index)
store      results in an SQLite file
runner     all realisations, in parallel
printed    the paper's Tables 2 and 3 as data
table      averages beside the paper's, as text, Markdown, CSV or JSON
show       the tables with their notes
figures    the paper's Figs. 4 and 5
"""
