"""The paper's figures from runs of this software, beside the claims of the paper."""
