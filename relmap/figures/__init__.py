"""The paper's figures from runs of this software, beside what the paper claims with them."""
