from .checker.certificate import ClaimVerdict as ClaimVerdict
from .checker.certificate import ProofVerdict as ProofVerdict
from .checker.certificate import check_proof as check_proof
from .proof_of_orbit import check_proof_of as check_proof_of
from .proof_file import write_proof as write_proof
from .prover import ProofSettings as ProofSettings
from .prover import prove as prove
from .theorem import Proof as Proof
