"""How reports look: for a screen, a phone and an A4 page."""

__all__ = ["STYLE"]

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; color: #1a1a1a;
  background: #fff; max-width: 52rem; margin: 0 auto; padding: 1rem 1rem 3rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; margin: 0 0 .5rem; line-height: 1.2; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .5rem; padding-bottom: .2rem; border-bottom: 1px solid #ccc; }
h3 { font-size: 1.05rem; margin: 1.2rem 0 .3rem; }
article h3 { margin-top: 0; }
p { margin: .5rem 0; }
li { margin: .25rem 0; }
.kind { color: #555; margin: 0; }
.headline { font-size: 1.1rem; padding: .6rem .9rem; border-left: 5px solid #999; background: #f4f4f4; }
.headline.named { border-color: #0072B2; }
.headline.unexplained { border-color: #D55E00; }
.headline.nothing { border-color: #009E73; }
article { margin: .9rem 0; padding: .7rem .9rem; border: 1px solid #ccc; border-radius: 4px; }
.status { font-size: .75rem; font-weight: 600; padding: .1rem .45rem; border-radius: 3px; border: 1px solid #0072B2;
  color: #00507d; white-space: nowrap; }
.status.surrogate, .status.unexplained { border-color: #b04d00; color: #8a3c00; }
/* A shadow at the side where a wide table goes on. */
.wide { overflow-x: auto; margin: .7rem 0; background:
  linear-gradient(90deg, #fff 30%, #fff0) 0 0 / 2.5rem 100% local no-repeat,
  linear-gradient(270deg, #fff 30%, #fff0) 100% 0 / 2.5rem 100% local no-repeat,
  linear-gradient(90deg, #0003, #0000) 0 0 / .8rem 100% scroll no-repeat,
  linear-gradient(270deg, #0003, #0000) 100% 0 / .8rem 100% scroll no-repeat; }
table { border-collapse: collapse; font-size: .88rem; }
th, td { text-align: left; vertical-align: top; padding: .22rem .9rem .22rem 0; }
th:last-child, td:last-child { padding-right: 0; }
th { border-bottom: 1px solid #888; font-weight: 600; white-space: nowrap; }
td { border-bottom: 1px solid #eee; }
.r { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.t { min-width: 12rem; }
figure { margin: 1rem 0; }
.shot { overflow-x: auto; }
.shot img { display: block; width: 100%; height: auto; }
.shot img.small { width: auto; max-width: 100%; }
figcaption, .quiet { color: #555; font-size: .85rem; }
.equation { overflow-x: auto; overflow-y: hidden; padding: .3rem 0 .3rem 2rem; text-indent: -2rem; }
.formula { line-height: 2.1; }
math { font-size: 1.1rem; text-indent: 0; }
math .new { color: #b04d00; font-weight: 700; background: #fdf0e0; }
code { font-size: .9rem; }
.hash { font: .75rem ui-monospace, monospace; word-break: break-all; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1rem; font-size: .88rem; }
dt { color: #555; }
dd { margin: 0; min-width: 0; }
details { margin: .6rem 0; }
summary { cursor: pointer; }
@media (max-width: 40rem) { .shot img { width: 42rem; max-width: none; }
  figcaption::before { content: "\u2194 "; } }
@media (max-width: 34rem) { body { font-size: 15px; padding: .7rem .7rem 2rem; } dl { grid-template-columns: 1fr; }
  dd { margin-bottom: .4rem; } th, td { padding-right: .5rem; } table { font-size: .8rem; } }
@media print { @page { margin: 15mm; } body { font-size: 10pt; max-width: none; padding: 0; }
  p, li { orphans: 3; widows: 3; }
  h2, h3, summary, h2 + p { break-after: avoid; } h2 + p { break-inside: avoid; }
  figure, article, tr, .wide, .equation, dl { break-inside: avoid; }
  thead { display: table-header-group; } .wide, .equation, .shot { overflow: visible; background: none; }
  table { font-size: 8.5pt; } .t { min-width: 0; }
  .shot img { width: auto; max-width: 100%; max-height: 20.5cm; margin: 0 auto; } .shot img.small { margin: 0; }
  figcaption::before { content: ""; } details::details-content { content-visibility: visible; display: block; } }
"""
