"""MuJoCo: cables are spatial tendons that may not exceed their rest length."""
