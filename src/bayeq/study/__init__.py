"""Monte Carlo campaigns: the paper's section 4.1 as a study that can be stopped, continued and shown.

config     what a study is: its numbers and its names
runner     one realisation, the methods compared, all realisations in parallel, and their store
table      averages beside the paper's, as text, Markdown, CSV or JSON
figures    the paper's Figs. 4 and 5
cells      benchmarks that others have set, on the same store; `dysts`, `odebench` run on them
"""
