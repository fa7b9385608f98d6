"""Gymnasium environments: FlexibleArm-v0 and TwoLinkFlexArm-v0."""
