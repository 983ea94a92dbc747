"""The style sheet of the report: for wide and narrow screens, and for print."""

from __future__ import annotations

STYLE = """
:root { color-scheme: light; --ink: #1a1a1a; --line: #cfcfcf; --blue: #0072B2; --pale: #f4f4f4; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem 1.2rem 3rem; max-width: 62rem; color: var(--ink); background: #fff;
  font: 16px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: .6rem 0; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; border-bottom: 1px solid var(--line); padding-bottom: .2rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
.verdict { border-left: .5rem solid var(--blue); background: var(--pale); padding: .7rem 1rem; }
.verdict.none { border-color: #D50000; }
.verdict.doubt { border-color: #E69F00; }
.verdict p { margin: .2rem 0; }
.equation { font-size: 1.3rem; line-height: 2; margin: .4rem 0; }
.equation math { white-space: nowrap; }
math { font-family: "STIX Two Math", "Cambria Math", "Latin Modern Math", math, serif; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
th { border-bottom: 2px solid var(--ink); }
th.said, td.said { text-align: left; }
tr.absent td { color: #666; }
code, pre { font: .85rem/1.45 ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; }
pre { background: var(--pale); padding: .6rem .8rem; white-space: pre-wrap; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1rem; margin: 0; }
dt { color: #555; } dd { margin: 0; }
.note { color: #555; font-size: .9rem; }
figure { margin: 1.2rem 0; }
figcaption { font-size: .9rem; color: #444; margin-top: .2rem; }
figure img { max-width: 100%; height: auto; display: block; }
.live { display: none; width: 100%; }
html.scripted figure.both .live { display: block; }
html.scripted figure.both .still { display: none; }
.pictures { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem 1.5rem; grid-auto-flow: dense; }
.pictures figure { margin: 0; min-width: 0; grid-column: 1 / -1; }
.pictures figure.narrow { grid-column: auto; }
li { margin: .4rem 0; }
@media (max-width: 40rem) {
  body { padding: .6rem .8rem 2rem; font-size: 15px; }
  .equation { font-size: 1.1rem; }
  dl { grid-template-columns: 1fr; gap: 0; } dd { margin-bottom: .5rem; }
  table { font-size: .78rem; overflow-wrap: normal; } th, td { padding: .25rem .25rem; white-space: normal; }
  .terms :is(th, td):nth-child(3) { display: none; }  /* the interval says the same */
  .terms :is(th, td):nth-child(6) { display: none; }
  .pictures { display: block; } .pictures figure { margin: 1.2rem 0; }
}
@media print {
  @page { margin: 16mm; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  h2, h3 { break-after: avoid; }
  figure, table, pre, .verdict { break-inside: avoid; }
  html.scripted figure.both .live { display: none; }
  html.scripted figure.both .still { display: block; }
  .wide { overflow: visible; }
  table { font-size: 8.5pt; } th, td { padding: .1rem .4rem; }
  .pictures { display: block; }
  .pictures figure { margin: 0 0 6mm; }
  .pictures figure.narrow { display: inline-block; width: 49%; vertical-align: top; }
}
"""
