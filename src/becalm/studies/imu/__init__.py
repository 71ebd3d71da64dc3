"""The IMU paper (Kownacki 2010)."""
