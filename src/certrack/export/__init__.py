"""The controller for other tools: what an export is given, and the duties of its author.

An export is one function of a system. It is given the controller as a
:class:`~certrack.export.program.ControllerProgram`: named formulas in the order in which they are
computed, their numbers, the natural names of all symbols, and the states before the first sample.
So it decides how formulas are printed, and nothing of control. C (``c/``), Structured Text
(``st/``) and FMUs (``fmu/``, around that C) are such exports. ``python_control.py`` is none: it
hands over functions, not text, of the continuous loop as well.

The author of a new one

1. writes a folder, or a file, of its own with one public function of a system, a name and, by
   keyword, a period. It begins with :func:`~certrack.export.program.sampled_system`, which refuses
   a system without a period, and :func:`~certrack.export.program.controller_program`;
2. prints by a subclass of :class:`~certrack.core.printing.FormulaPrinter`. A literal must give the
   same number when it is read. The steps come first, up to the input, then the rates, then the
   next states, which are all computed from the states before;
3. derives identifiers from ``program.labels``: of the language's alphabet, not reserved, never
   taken twice, also where the language takes capitals for small letters. What a user wrote (title,
   names, the text of the system) cannot end a comment that it stands in;
4. says which inputs are not read (:func:`~certrack.export.program.unread_states`) and what each
   input, output and state means;
5. gives the same bytes for the same system: no date, no path, no order of a hash;
6. refuses in one line, by an :class:`~certrack.core.errors.InputError`, what the language cannot
   hold, before a file is written; a folder is written as a whole or not at all;
7. keeps long texts as templates beside the code (:mod:`~certrack.export.templates`);
8. runs what it wrote in a test, in the language's own compiler, importer or interpreter, and
   compares: at the :func:`~certrack.export.golden_vectors.golden_vectors` or along a run, every
   function that a system file may use, limits, filters and projections, awkward names, and a wrong
   number in the text, which must be noticed;
9. if it runs on a drive, also prints a :class:`~certrack.export.monitor.MonitorProgram`: the flags,
   what stands still while it is disabled, what a reset sets. Nothing of it changes an export
   without a monitor;
10. adds a verb to ``cli/exports.py`` and a section to ``docs/bridges.md`` or
    ``docs/deployment.md``.
"""
