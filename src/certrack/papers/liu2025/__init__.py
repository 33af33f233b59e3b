"""L. Liu, G. Sun, R. Bai, Actuators 14(8):367, 2025, doi:10.3390/act14080367.

Runs both examples, draws Figures 1 to 4, and sets every claim beside what is measured. Our copy of
the paper has lost its minus signs, so Example 1 is run with every sign of x(0) and y_d.

`runs` has what is computed, `measures` what is read off a response, `claim` what a claim is;
`sections`, `theorem1`, `printed_laws`, `example1` and `example2` judge, `observations` adds what
the paper does not say; `figures`, `drawing` and `proof_figures` draw.
"""

from certrack.papers.liu2025.claim import Claim, Observation
from certrack.papers.liu2025.reproduction import Reproduction, reproduce

__all__ = ["Claim", "Observation", "Reproduction", "reproduce"]
