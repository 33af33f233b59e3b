"""The designer in the browser: gains as sliders, responses and guarantees that follow every move.

The server has no numerics: it hands jobs to worker processes and their answers to the page.

Server
    `launch` (a free port, one address), `server` (routes and static files), `security` (host,
    origin, key), `session` (one page: the newest move wins), `hub` (which worker does what next),
    `processes` (a worker as the server sees it), `workspace` (the files of one folder).
Worker
    `worker` (one process), `open_design` (a text, loaded and compiled), `responses` (a run as
    curves), `decimation`, `guarantee` (bounds with their words), `gains` (what a slider moves),
    `form` (every key as a field), `profiles` (the reference drawn, and first ones of other kinds),
    `description` (what the page knows of a system), `written_law` (plant and law as formulas),
    `long_tasks` (searches), `task_progress` (what they say meanwhile), `optimum`, `exports`.
Both
    `messages` (what a page may ask), `frames` (what it gets).

What the page itself does is in `static`: plain modules, without a build step.
"""
