"""The command line: `phugoid fit|diagnose|simulate|validate|example`. Imported by the command only."""
