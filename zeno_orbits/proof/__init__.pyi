from .checker.certificate import ClaimVerdict as ClaimVerdict
from .checker.certificate import ProofVerdict as ProofVerdict
from .checker.certificate import check as check
