from conftest_diagnosis import diagnosed

__all__ = ["diagnosed"]
