"""Gymnasium environments: FlexibleArm-v0, TwoLinkFlexArm-v0 and MultiLinkFlexArm-v0."""
