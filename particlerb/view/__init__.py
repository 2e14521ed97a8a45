"""The browser scene: shows a motion, pushes it, replays files. Holds no physics.

`session` is a motion that can be pushed, always the run of a case; `recording` writes that case.
`export.surfaces` are shown and clicked, `stage` puts them on the page, `number_tables` the
numbers. `live` and `replay` are the two pages. Only `stage`, `live`, `replay` and `server` know
the browser.
"""
