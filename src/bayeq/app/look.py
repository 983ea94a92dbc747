"""The style sheet of the page: that of the report, and what steps, channels and buttons need beside it."""

from __future__ import annotations

from bayeq.equation.report.look import STYLE

__all__ = ["BLUE", "RED", "SHEET"]

BLUE, RED = "#0072B2", "#B00020"

SHEET = (
    STYLE
    + """
.q-layout, .q-page-container, .q-page { min-height: 0 !important; }
.nicegui-content { display: block; padding: 0; }
.q-field, .q-btn, .q-uploader, .q-checkbox, .q-menu, .q-item { font-family: inherit; }
.q-btn { font-weight: 600; }
h1, h2, h3 { font-weight: 700; line-height: 1.3; letter-spacing: normal; }
.q-field--with-bottom { padding-bottom: .6rem; }
.q-field__bottom { position: static; transform: none !important; min-height: 0; padding: .2rem .75rem 0;
  font-size: .85rem; line-height: 1.3; color: #555; }
.q-checkbox { margin-left: -.5rem; }
.q-field--dense .q-field__label, .q-field__native { font-size: 1rem; }
p { margin: .4rem 0; }
a { color: var(--blue); }
:focus-visible { outline: 3px solid var(--blue); outline-offset: 2px; }
.lead { font-size: 1.05rem; max-width: 44rem; }
.error { border-left: .5rem solid #D50000; background: var(--pale); padding: .5rem 1rem; margin: .7rem 0; }
.said { border-left: .5rem solid #E69F00; background: var(--pale); padding: .5rem 1rem; margin: .7rem 0; }
.error p, .said p { margin: .1rem 0; }
ul { padding-left: 1.2rem; margin: .4rem 0; }
.drop { width: 100% !important; border: 2px dashed #8a8a8a; border-radius: 6px; box-shadow: none; max-height: 11rem; }
.drop.q-uploader--dnd { border-color: var(--blue); }
.drop .q-uploader__header { background: var(--pale); color: var(--ink); }
.drop .q-uploader__list { display: none; }
.drop-words { display: flex; flex-wrap: wrap; gap: .6rem 1.5rem; align-items: center; justify-content: space-between;
  padding: 1rem; }
.drop-words span:first-child { flex: 1 1 16rem; }
.drop .q-uploader__dnd { outline: none; }
.channels { display: grid; grid-template-columns: minmax(7rem, max-content) minmax(12rem, 1fr) 15rem; gap: .2rem 1.2rem;
  align-items: center; }
.channels.several { grid-template-columns: minmax(7rem, max-content) minmax(9rem, 1fr) 15rem 7rem; }
.channels > * { min-width: 0; }
.channel-name { font-weight: 600; }
.channel-about { font-size: .9rem; color: #444; }
.fields { display: grid; grid-template-columns: repeat(3, 1fr); gap: .2rem 1.2rem; }
.fields .whole { grid-column: 1 / -1; }
.command span { display: inline-block; max-width: 100%; vertical-align: top; }
.buttons { display: flex; flex-wrap: wrap; gap: .8rem; align-items: center; margin: .6rem 0; }
.button-like { border: 1px solid var(--blue); border-radius: 4px; padding: .35rem .9rem; text-decoration: none;
  font-weight: 600; }
.button-like:hover { background: var(--pale); }
.report { border: 0; display: block; width: calc(100% + 2.4rem); margin: .5rem -1.2rem 0; min-height: 30rem; }
.q-linear-progress { margin: .6rem 0; }
@media (max-width: 40rem) {
  .channels { grid-template-columns: 1fr; gap: .1rem; }
  .channels.several { grid-template-columns: 1fr 7.7rem; gap: .1rem .6rem; }
  .channels.several > .channel-name, .channels.several > .channel-about { grid-column: 1 / -1; }
  .channels .q-field { margin-bottom: .7rem; }
  .fields { grid-template-columns: 1fr; }
  .report { width: calc(100% + 1.6rem); margin: .5rem -.8rem 0; }
}
"""
)
