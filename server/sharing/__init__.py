"""Results that everybody may see: a team makes its submission public, or the rules of a stage do."""
