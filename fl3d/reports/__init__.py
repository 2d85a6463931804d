"""Tables, figures and pages of any sweep, drawn from frames; no paper and no store is known here."""
